// SPDX-License-Identifier: GPL-3.0-or-later
/** What is wrong with a page or with its browser, as a sentence for its reader. */

export class PageError extends Error {}

/** The error of a page whose data are not what they should be. */
export function damaged(what) {
  return new PageError(`This page is damaged: ${what}. Copy or export it again.`);
}

/** The sentence of any error: what was not foreseen keeps its own words for a report. */
export function sentence(error) {
  if (error instanceof PageError) return error.message;
  if (error instanceof RangeError) return "This page needs more memory than the browser gives it. Close other tabs, or export it smaller.";
  return `This page cannot be shown (${error && error.message ? error.message : error}). Try another browser.`;
}
