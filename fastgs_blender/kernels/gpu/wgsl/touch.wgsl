// 1 for each splat of a piece, in the order of depth, that may touch the grid; the others stay as they are.

//threads grid.size.x
//include ellipse

@group(0) @binding(0) var<uniform> grid: Grid; // size: splats, first row of the piece, its rows
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> depths: array<u32>;
@group(0) @binding(3) var<storage, read> splat_a: array<vec4f>;
@group(0) @binding(4) var<storage, read> splat_b: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> touches: array<u32>;

fn thread(k: u32) {
    let row = order[k] - grid.size.y;
    if row >= grid.size.z || depths[row] == 0xffffffffu { // what lies before the piece is far beyond it, too
        return;
    }
    let rows = ellipse(splat_a[row], splat_b[row]).rows;
    touches[k] = u32(rows.x <= rows.y);
}
