// SPDX-License-Identifier: GPL-3.0-or-later
/** How many pixels a picture has for each of the window's: all that the screen shows while it stands still, fewer while frames are slow. */
const MOST = 2; // for each of the window's, along an edge
const PIXELS = 5e6; // of a picture
const STEPS = [1, 0.75, 0.55, 0.4];
const SLOW = 1 / 27, QUICK = 1 / 50; // seconds a frame
const COUNT = 12; // frames that are looked at before a step

export class Sharpness {
  constructor() {
    Object.assign(this, { step: 0, times: [], drawn: 0, tired: 0 });
  }

  /** Pixels for each of the window's, for a screen with `ratio` of them and a window of this size. */
  scale(ratio, [width, height], still) {
    const full = Math.min(ratio, MOST, Math.sqrt(PIXELS / (width * height)));
    return still ? full : full * STEPS[this.step];
  }

  /** Notes how long a moving frame took.  What was once too slow is tried again after a while only. */
  took(seconds) {
    this.times.push(seconds);
    if (this.times.length < COUNT) return;
    const middle = this.times.sort((a, b) => a - b)[COUNT >> 1];
    this.times = [];
    this.tired = Math.max(this.tired - 1, 0);
    if (middle > SLOW && this.step < STEPS.length - 1) Object.assign(this, { step: this.step + 1, tired: 20 });
    else if (middle < QUICK && this.step > 0 && !this.tired) this.step -= 1;
  }
}
