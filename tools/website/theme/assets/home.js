/* SPDX-License-Identifier: GPL-3.0-or-later */
/* The first page: which system this is, and who has the pointer, the page or the scene on its stage. */
const agent = navigator.userAgent
const here = /Windows/.test(agent) ? "windows" : /Mac OS X/.test(agent) && !/iPhone|iPad/.test(agent) ? "macos"
  : /Linux/.test(agent) && !/Android/.test(agent) ? "linux" : ""
document.querySelector(`.system[data-system="${here}"]`)?.classList.add("system--here")

const stage = document.querySelector(".stage"), hands = document.querySelector("[data-stage-hands]")

/* Until it is asked for, the scene takes no wheel and no touch, so that both scroll the page. */
function give(to) {
  stage.classList.toggle("stage--hands", to)
  hands.textContent = to ? "Done" : "Look around"
  if (to) stage.querySelector("iframe").focus()
}

if (hands) {
  addEventListener("message", ({data, source}) => // until the scene says that it draws, or for ever, README's film is seen
    source === stage.querySelector("iframe").contentWindow && stage.classList.toggle("stage--live", data?.fastgs === "ready"))
  hands.addEventListener("click", () => give(!stage.classList.contains("stage--hands")))
  new IntersectionObserver(([seen]) => seen.isIntersecting || give(false)).observe(stage)
}
