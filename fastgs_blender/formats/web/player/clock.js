// SPDX-License-Identifier: GPL-3.0-or-later
/** The time of a page: playing, loop and speed.  Where a sound plays, the picture follows it. */
const GAP = 0.12; // seconds that picture and sound may be apart before one jumps
const SPEEDS = [0.125, 0.25, 0.5, 1, 2];

export class Clock {
  /**
   * frames, fps, loop   the scene's time line
   * now()               seconds of any clock that only goes on
   * sound               null, or {playing, time, seek(time), follow(time), play(time), pause(), speed}: its times are the scene's
   */
  constructor({ frames, fps, loop }, now, sound = null) {
    Object.assign(this, { frames, fps, loop, now, sound, time: 0, playing: false, speed: 1, before: now(), onchange: () => {} });
    /** Where the last frame begins, and where the first one follows it. */
    this.last = (frames - 1) / fps;
    this.length = frames / fps;
  }

  get frame() {
    return Math.min(this.time * this.fps, this.loop ? this.frames : this.frames - 1);
  }

  /** Whether there is anything to play. */
  get moves() {
    return this.frames > 1;
  }

  /** Goes on to now(); returns whether the picture's time is another one. */
  step() {
    const now = this.now(), passed = Math.max(now - this.before, 0), before = this.time;
    this.before = now;
    if (!this.playing) return false;
    let time = before + passed * this.speed;
    if (this.sound) this.sound.follow(before);
    if (this.sound && this.sound.playing) {
      const apart = this.sound.time - time;
      time += Math.abs(apart) > GAP ? apart : apart * Math.min(passed * 4, 1); // sounds say their time in coarse steps
    }
    const end = this.loop ? this.length : this.last;
    if (time >= end) {
      time = this.loop ? time % end : end;
      if (this.loop) this.cue(time);
      else this.pause(time);
    }
    this.time = Math.max(time, 0);
    return this.time !== before;
  }

  play() {
    if (!this.moves || this.playing) return;
    if (!this.loop && this.time >= this.last) this.time = 0;
    Object.assign(this, { playing: true, before: this.now() });
    this.cue(this.time);
    if (this.sound) this.sound.play(this.time);
    this.onchange();
  }

  pause(time = this.time) {
    Object.assign(this, { playing: false, time });
    if (this.sound) this.sound.pause();
    this.onchange();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  /** Goes to a second, within the clip. */
  seek(time) {
    this.time = Math.min(Math.max(Number.isFinite(time) ? time : 0, 0), this.last);
    this.cue(this.time);
    this.onchange();
  }

  cue(time) {
    if (this.sound) this.sound.seek(time);
  }

  /** Stops at a frame before or after; a loop goes on at its other end. */
  stepFrames(by) {
    if (this.playing) this.pause();
    const near = this.time * this.fps, whole = Math.round(near), to = (Math.abs(near - whole) < 1e-3 ? whole : by > 0 ? Math.floor(near) : Math.ceil(near)) + by;
    this.seek((this.loop ? ((to % this.frames) + this.frames) % this.frames : to) / this.fps);
  }

  /** The next faster (1) or slower (-1) speed. */
  faster(by) {
    this.hasten(SPEEDS[Math.min(Math.max(SPEEDS.indexOf(this.speed) + by, 0), SPEEDS.length - 1)]);
  }

  hasten(speed) {
    this.speed = speed;
    if (this.sound) this.sound.speed = speed;
    this.onchange();
  }
}

/** A page's sound as a clock's; start: the second of it at which the scene begins. */
export class Sound {
  constructor(element, start) {
    Object.assign(this, { element, start, wanted: false, broken: false });
  }

  /** Whether it says what time it is. */
  get playing() {
    const { paused, ended, seeking, readyState } = this.element;
    return this.wanted && !paused && !ended && !seeking && readyState > 2;
  }

  get time() {
    return this.element.currentTime - this.start;
  }

  /** Whether there is sound at a second of the scene: it may begin later, and be over earlier. */
  covers(time) {
    const at = time + this.start;
    return at >= 0 && !(at >= this.element.duration);
  }

  seek(time) {
    if (!this.covers(time)) this.element.pause();
    else if (Math.abs(this.time - time) > 0.02) this.element.currentTime = time + this.start;
  }

  /** Begins where the scene reaches it. */
  follow(time) {
    if (this.wanted && this.element.paused && !this.broken && this.covers(time)) this.begin(time);
  }

  play(time) {
    this.wanted = true;
    this.follow(time);
  }

  /** Browsers let no page be heard before it is touched: then it plays without being heard. */
  begin(time) {
    this.seek(time);
    this.element.play().catch((error) => {
      if (error.name === "AbortError") return; // paused meanwhile
      if (error.name === "NotAllowedError" && !this.element.muted) this.element.muted = true;
      else this.broken = true;
    });
  }

  pause() {
    this.wanted = false;
    this.element.pause();
  }

  get muted() {
    return this.element.muted;
  }

  set muted(muted) {
    Object.assign(this.element, { muted });
    this.broken = false;
  }

  set speed(speed) {
    this.element.playbackRate = speed;
  }
}
