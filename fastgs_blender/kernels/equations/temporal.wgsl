// Temporal opacity (model/temporal.py): the factor of each kind at a time t, of a Gaussian with the centre mu_tau and the parameters p.

fn temporal_factor(kind: i32, t: f32, mu_tau: f32, p: vec4f) -> f32 {
    let delta: f32 = t - mu_tau;
    if (kind == {TEMPORAL_RADIAL}) {
        return exp(-exp(p.x) * delta * delta);
    }
    if (kind == {TEMPORAL_WINDOW}) {
        let early: f32 = max(p.x - t, 0.0) / exp(p.z);
        let late: f32 = max(t - p.y, 0.0) / exp(p.w);
        return exp(-early * early - late * late);
    }
    if (kind == {TEMPORAL_RADIAL_WINDOW}) {
        let outside: f32 = max(max(p.y - t, t - p.z), 0.0) / exp(p.w);
        return exp(-exp(p.x) * delta * delta - outside * outside);
    }
    return 1.0;
}

//backward

// From the gradient g of the factor's logarithm to those of the parameters.
fn temporal_slope(kind: i32, t: f32, mu_tau: f32, p: vec4f, g: f32) -> vec4f {
    let delta: f32 = t - mu_tau;
    var slope: vec4f = vec4f(0.0);
    if (kind == {TEMPORAL_WINDOW}) {
        let before: f32 = exp(p.z);
        let after: f32 = exp(p.w);
        let early: f32 = max(p.x - t, 0.0) / before;
        let late: f32 = max(t - p.y, 0.0) / after;
        slope = vec4f(-2.0 * g * early / before, 2.0 * g * late / after, 2.0 * g * early * early, 2.0 * g * late * late);
    }
    if (kind == {TEMPORAL_RADIAL} || kind == {TEMPORAL_RADIAL_WINDOW}) {
        slope.x = -g * exp(p.x) * delta * delta;
    }
    if (kind == {TEMPORAL_RADIAL_WINDOW}) {
        let width: f32 = exp(p.w);
        let outside: f32 = max(max(p.y - t, t - p.z), 0.0) / width;
        if (p.y - t >= t - p.z) {
            slope.y = -2.0 * g * outside / width;
        } else {
            slope.z = 2.0 * g * outside / width;
        }
        slope.w = 2.0 * g * outside * outside;
    }
    return slope;
}

// To that of mu_tau.
fn temporal_rate(kind: i32, t: f32, mu_tau: f32, p: vec4f, g: f32) -> f32 {
    if (kind == {TEMPORAL_RADIAL} || kind == {TEMPORAL_RADIAL_WINDOW}) {
        return 2.0 * g * exp(p.x) * (t - mu_tau);
    }
    return 0.0;
}
