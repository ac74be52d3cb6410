// Write the entries of the tile lists: for each splat, in the order of depth, a run of the tiles that it touches; an entry's value is its
// own place.

//threads grid.size.x
//include ellipse

@group(0) @binding(0) var<uniform> grid: Grid;
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> starts: array<u32>;
@group(0) @binding(3) var<storage, read> splat_a: array<vec4f>;
@group(0) @binding(4) var<storage, read> splat_b: array<vec4f>;
@group(0) @binding(5) var<storage, read> wanted: array<u32>;
@group(0) @binding(6) var<storage, read_write> tiles: array<u32>;
@group(0) @binding(7) var<storage, read_write> owner: array<u32>;
@group(0) @binding(8) var<storage, read_write> values: array<u32>;

// Whether a tile of the grid gets a list.
fn is_wanted(tile: i32) -> bool {
    return {ALL} || wanted[grid.size.z + u32(tile)] != 0u;
}

fn thread(k: u32) {
    var at = starts[k];
    if at == starts[k + 1u] {
        return;
    }
    let row = order[k];
    let a = splat_a[row];
    let b = splat_b[row];
    let e = ellipse(a, b);
    for (var y = e.rows.x; y <= e.rows.y; y++) {
        let x = span(e, a, b, y);
        for (var column = x.x; column <= x.y && at < grid.size.y; column++) {
            let tile = y * grid.tiles.z + column;
            if is_wanted(tile) {
                tiles[at] = u32(tile);
                owner[at] = row;
                values[at] = at;
                at++;
            }
        }
    }
}
