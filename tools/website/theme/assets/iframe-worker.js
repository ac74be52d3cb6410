/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Browsers start no worker from a file on disk.  There the search runs in a hidden frame, which looks like a worker to both sides. */
if (location.protocol === "file:")
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement("iframe")
      frame.hidden = true
      frame.srcdoc = "<!doctype html>"
      this.inside = new Promise(resolve => frame.addEventListener("load", async () => {
        const inside = frame.contentWindow
        const run = source => new Promise((done, failed) => {
          const script = Object.assign(inside.document.createElement("script"), {src: source, onload: done, onerror: failed})
          inside.document.body.append(script)
        })
        inside.postMessage = data => this.dispatchEvent(new MessageEvent("message", {data}))
        inside.importScripts = (...sources) => sources.reduce((before, source) => before.then(() => run(source)), Promise.resolve())
        await run(url)
        resolve(inside)
      }, {once: true}))
      document.body.append(frame)
      this.terminate = () => frame.remove()
    }

    postMessage(data) {
      this.inside.then(inside => inside.dispatchEvent(new inside.MessageEvent("message", {data})))
    }
  }
