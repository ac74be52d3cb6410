// Fill the unused end of the tile lists, whose length was guessed, with entries of a tile after the last one, and check the guess.

//threads max(job.x, 1u)

@group(0) @binding(0) var<uniform> job: vec4u; // room for entries, tiles, splats
@group(0) @binding(1) var<storage, read> runs: array<u32>; // entries of the splats before each one; the last is the number of all
@group(0) @binding(2) var<storage, read_write> tiles: array<u32>;
@group(0) @binding(3) var<storage, read_write> values: array<u32>;
@group(0) @binding(4) var<storage, read_write> longest: array<u32>;
@group(0) @binding(5) var<storage, read_write> spilled: array<u32>;

//include guessed

fn thread(e: u32) {
    let entries = runs[job.z];
    if e == 0u {
        check(entries, job.x);
    }
    if e < job.x && e >= entries {
        tiles[e] = job.y;
        values[e] = e;
    }
}
