// What the stages of the loss share: (1 - d) L1 + d (1 - SSIM), as kernels/cpu/loss.py states it.
//
// Pictures are [h, w, 3].  `picture` is what is compared, over its background; where a pixel's weight is below 1, it is first moved that far
// towards the target, but for the mean absolute difference.

struct Loss {
    size: vec4u,       // width, height, whether pixels have weights, numbers of a picture
    scales: vec4f,     // of the gradients of sum |x - y| and of sum SSIM; share of the view; weight of opacity
    background: vec4f, // and whether there is one
    taps: array<vec4f, 3>, // weights of the Gaussian window
}

const REACH = 5;

fn tap(i: i32) -> f32 {
    return job.taps[i / 4][i % 4];
}
