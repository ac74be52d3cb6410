// Checks a number against the room that was guessed for it (guesses.py), by one thread: records it, and where it does not fit, sets
// `spilled`.  The stages that update parameters or statistics then change nothing.

fn check(number: u32, room: u32) {
    longest[0] = max(longest[0], number);
    if number > room {
        spilled[0] = 1u;
    }
}
