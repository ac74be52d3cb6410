// How many tiles each splat touches, in the order of the splats' depth.

//threads grid.size.x
//include ellipse

@group(0) @binding(0) var<uniform> grid: Grid;
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> depths: array<u32>;
@group(0) @binding(3) var<storage, read> splat_a: array<vec4f>;
@group(0) @binding(4) var<storage, read> splat_b: array<vec4f>;
@group(0) @binding(5) var<storage, read> wanted: array<u32>;
@group(0) @binding(6) var<storage, read_write> counts: array<u32>;

// Whether a tile of the grid gets a list.
fn is_wanted(tile: i32) -> bool {
    return {ALL} || wanted[grid.size.z + u32(tile)] != 0u;
}

fn thread(k: u32) {
    let row = order[k];
    var count = 0u;
    if depths[row] != 0xffffffffu {
        let a = splat_a[row];
        let b = splat_b[row];
        let e = ellipse(a, b);
        for (var y = e.rows.x; y <= e.rows.y; y++) {
            let x = span(e, a, b, y);
            if {ALL} {
                count += u32(max(x.y - x.x + 1, 0));
                continue;
            }
            for (var column = x.x; column <= x.y; column++) {
                count += u32(is_wanted(y * grid.tiles.z + column));
            }
        }
    }
    counts[k] = count;
}
