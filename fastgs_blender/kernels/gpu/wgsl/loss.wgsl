// Declarations that the stages of the loss share.  The loss is (1 - d) L1 + d (1 - SSIM), as kernels/cpu/loss.py states it.
//
// Pictures are [h, w, 3].  `picture` is the rendered one over its background.  A pixel whose weight is below 1 is moved towards the target
// in proportion, except for the mean absolute difference, which takes the rendered colour.  A picture whose moments are too large for one
// buffer is compared in strips of rows, which overlap.

struct Loss {
    size: vec4u,       // width, height, whether pixels have weights, numbers of a picture
    scales: vec4f,     // of the gradients of sum |x - y| and of sum SSIM; share of the view; weight of opacity
    background: vec4f, // and whether there is one
    taps: array<vec4f, 3>, // weights of the Gaussian window
    strip: vec4u,      // the first number that a stage computes, how many; the first one that `moments`, `slopes`, `across` hold, how many
    counted: vec4u,    // the first number whose loss counts here, how many: others belong to the next strips
}

const REACH = 5;

fn tap(i: i32) -> f32 {
    return job.taps[i / 4][i % 4];
}
