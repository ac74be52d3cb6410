// The uniform data of the stages that read a model: an instance seen by a camera, as scene.py packs it.

struct View {
    row0: vec4f,     // model to camera: rows of the matrix, the translation last
    row1: vec4f,
    row2: vec4f,
    eye: vec4f,      // the camera's centre in model space; orthographic: its direction
    lens: vec4f,     // fx, fy, cx, cy
    limits: vec4f,   // lowest and highest x / z, lowest and highest y / z, of the Jacobian
    frame: vec4f,    // first and last pixel centre in x, first and last in y
    depths: vec4f,   // near, far, middle of the image in x and in y
    raster: vec4f,   // blur, highest alpha, alpha cut, log2 of the cut
    ball: vec4f,     // centre, squared radius
    time: vec4f,     // t; of Sampling (rendering/distance.py): zoom
    beyond: vec4f,   // of Sampling: the ball that holds the capture's cameras
    sampling: vec4f, // pixel, coarse, least, reach
    sampled: vec4u,  // whether it fades; number of cameras; their first number in `extra`
    look: array<vec4f, 5>,
    size: vec4u,     // Gaussians, row of the first splat, numbers of a splat's channels, Gaussians of the whole model before these
    widths: vec4u,   // coefficients of the motion, of the rotation; columns of temporal, of features
    kinds: vec4u,    // temporal opacity, appearance, degree, number of features at one moment
    plan: vec4u,     // first channel of the colour; then the channels of weight, depth and plane, + 1, or 0 where there is none
    terms: vec4u,    // weights of motion, rotation and colour that follow in `extra`; number of crops
    flags: vec4u,    // bits of CENTRED ...; nodes of a volume's side; first number of the volumes in `extra`; coefficients of the colour
}

const MOTION_CENTRED = 1u;
const ROTATION_CENTRED = 2u;
const COLOUR_CENTRED = 4u;
const ANTIALIASED = 8u;
const ORTHOGRAPHIC = 16u;
const HIDDEN = 32u;
const DETACHED = 64u; // of the backward pass: the gradient of mu_tau comes through the temporal opacity alone
const BLURRED = 128u; // planes of depth have the blur, see rendering/layout.py, by_pixel

const SH = {APPEARANCE_SH}u;
const FEATURES = {APPEARANCE_FEATURES}u;

fn has(flag: u32) -> bool {
    return (view.flags.x & flag) != 0u;
}
