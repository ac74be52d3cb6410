// Which tiles a splat touches, exactly (kernels/cpu/tiles.py): those at whose pixel centres the ellipse in which alpha reaches the cut lies.

struct Grid {
    tiles: vec4i,  // first tile in x and in y, columns, rows
    size: vec4u,   // splats, the most entries of the lists, number of the grid's first tile in `wanted`
}

const SIDE = {TILE};
const MARGIN = 1e-3; // pixels by which an extent is widened, so that rounding loses no pixel, and 1e-5 of the extent

struct Ellipse {
    box: vec4i,   // first and last pixel in x, first and last in y
    rows: vec2i,  // first and last row of tiles within the grid
    exact: bool,  // whether each row has an extent of its own; else it is the box's
    reach: f32,   // the squared distance at which alpha is the cut
    peak: f32,    // where the rightmost point lies in y, with the sign turned
    margin: f32,
}

fn centres(middle: f32, radius: f32) -> vec2i {
    return vec2i(i32(ceil(max(middle - radius, -1e9) - 0.5)), i32(floor(min(middle + radius, 1e9) - 0.5)));
}

fn ellipse(a: vec4f, b: vec4f) -> Ellipse {
    let reach = max(b.y - b.w, 0.0);
    let root = sqrt(reach);
    let steep = length(vec2f(b.x, a.w));
    let radius = root * vec2f(steep / (a.z * b.x), 1.0 / b.x);
    let margin = MARGIN + 1e-5 * max(radius.x, radius.y);
    let x = centres(a.x, radius.x + margin);
    let y = centres(a.y, radius.y + margin);
    let left = grid.tiles.x * SIDE;
    let top = grid.tiles.y * SIDE;
    let box = vec4i(max(x.x, left), min(x.y, left + grid.tiles.z * SIDE - 1), max(y.x, top), min(y.y, top + grid.tiles.w * SIDE - 1));
    if box.x > box.y || box.z > box.w {
        return Ellipse(box, vec2i(0, -1), false, 0.0, 0.0, 0.0);
    }
    let rows = vec2i(box.z / SIDE, box.w / SIDE) - grid.tiles.y;
    let exact = rows.x < rows.y && box.x / SIDE < box.y / SIDE;
    return Ellipse(box, rows, exact, reach, a.w * root / (b.x * steep), margin);
}

// First and last column of tiles, within the grid, that an ellipse touches in a row of tiles; the first is larger where it touches none.
fn span(e: Ellipse, a: vec4f, b: vec4f, row: i32) -> vec2i {
    var x = e.box.xy;
    if e.exact {
        let low = f32((grid.tiles.y + row) * SIDE) + 0.5 - a.y;
        let high = low + f32(SIDE - 1);
        let right = clamp(-e.peak, low, high);
        let left = clamp(e.peak, low, high);
        let right_end = (sqrt(max(e.reach - b.x * b.x * right * right, 0.0)) - a.w * right) / a.z;
        let left_end = (-sqrt(max(e.reach - b.x * b.x * left * left, 0.0)) - a.w * left) / a.z;
        x = vec2i(max(i32(ceil(max(a.x + left_end - e.margin, -1e9) - 0.5)), e.box.x),
                  min(i32(floor(min(a.x + right_end + e.margin, 1e9) - 0.5)), e.box.y));
        if x.x > x.y {
            return vec2i(0, -1);
        }
    }
    return vec2i(x.x / SIDE, x.y / SIDE) - grid.tiles.x;
}
