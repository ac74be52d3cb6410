// The uniform data of the stages that turn blended features into colour: the camera, the look and the sizes, as picture.py packs them.

struct Decoder {
    ray_x: vec4f,  // rows of camera to model; last the camera's centre in the model
    ray_y: vec4f,
    ray_z: vec4f,
    lens: vec4f,   // fx, fy, cx, cy
    corner: vec4f, // x and y of the first pixel; whether the camera is orthographic; what the decoder is given
    look: array<vec4f, 5>,
    size: vec4u,   // pixels, width, numbers of a pixel's channels, the first pixel in the whole picture
    plan: vec4u,   // first channel; where a pixel's weight lies among how many numbers; activation, or PLAIN
}

const SIGMOID = {ACTIVATION_SIGMOID}u;
const CLAMP = {ACTIVATION_CLAMP}u;
const PLAIN = 3u;
const NORMALISED = 0.0;
const PREMULTIPLIED = 1.0;
const LIFTED = 2.0;
