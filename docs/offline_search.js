// SPDX-FileCopyrightText: 2026 Trackslip authors
// SPDX-License-Identifier: Apache-2.0
// Pages that are opened as files may start no worker: the search runs in a hidden frame instead.
(() => {
  if (location.protocol !== "file:") return
  class IFrameWorker extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement("iframe")
      frame.hidden = true
      document.body.append(frame)
      this.inside = frame.contentWindow
      const page = this.inside.document
      page.open()
      page.write("<!doctype html><body></body>")
      page.close()
      this.inside.postMessage = data => this.dispatchEvent(new MessageEvent("message", { data }))
      this.inside.importScripts = (...urls) => urls.reduce((before, one) => before.then(() => load(page, one)), Promise.resolve())
      this.ready = load(page, url)
    }
    postMessage(data) {
      this.ready.then(() => this.inside.dispatchEvent(new MessageEvent("message", { data })))
    }
    terminate() {
      this.inside.frameElement.remove()
    }
  }
  const load = (page, url) => new Promise((done, failed) => {
    const script = page.createElement("script")
    Object.assign(script, { src: url, onload: done, onerror: failed })
    page.body.append(script)
  })
  window.IFrameWorker = window.Worker = IFrameWorker
})()
