// SPDX-FileCopyrightText: 2026 Trackslip authors
// SPDX-License-Identifier: Apache-2.0
// Behaviour of a report: the first plots are shown at once, the others follow one by one. A mouse drags to zoom;
// a finger scrolls the page and zooms with the buttons.

const NARROW = 760, LOW = 380, BORDER = 66 // pixels: narrow pages have a lower path plot and narrower borders
const CHARACTER = 6.2, SYMBOL = 34, LEGEND_ROW = 22 // pixels: size of a legend's letters, symbols and rows
const AROUND = 65 // pixels: height of a plot's title and axis
const DRAGGED = ["BoxZoomTool", "WheelZoomTool"]

const model = name => Bokeh.documents[0].get_model_by_name(name)
const waiting = [...document.querySelectorAll("[data-plot]")].map(({dataset}) => dataset.plot).filter(name => name !== "path")

function reveal() {
  const hidden = waiting.find(name => !model(name).visible)
  if (hidden === undefined) {
    document.documentElement.dataset.drawn = "all"
    return
  }
  model(hidden).visible = true
  requestAnimationFrame(() => setTimeout(reveal))
}

function narrow() {
  model("path").height = LOW
  const width = document.querySelector(".times").clientWidth - BORDER
  for (const plot of Bokeh.documents[0].roots()) {
    plot.min_border_left = BORDER
    for (const part of plot.center) if (part.type === "Legend" && part.visible) wrap(plot, part, width)
  }
}

// Fits the columns of the legend to the width, and increases the plot's height by the additional rows
function wrap(plot, legend, width) {
  const {items, ncols} = legend
  const longest = Math.max(...items.map(({label}) => label.value.length))
  legend.ncols = Math.min(ncols, Math.max(1, Math.floor(width / (CHARACTER * longest + SYMBOL))))
  const more = LEGEND_ROW * (Math.ceil(items.length / legend.ncols) - Math.ceil(items.length / ncols))
  if (more === 0 || plot.name === "path") return
  const {start, end} = plot.y_range, share = more / (plot.height - AROUND)
  plot.y_range.end = plot.y_scale.type === "LogScale" ? end * (end / start) ** share : end + share * (end - start)
  plot.height += more
}

// Browsers decide by the style touch-action, before scripts run, whether a finger scrolls. Bokeh sets this style
// on plots with active tools; tools activated for a mouse would then take the first swipe.
function leave_fingers_to_the_page() {
  const [view] = Bokeh.index
  Object.getPrototypeOf(view)._update_touch_action = () => {}
}

function use_tools(active) {
  for (const tool of Bokeh.documents[0].all_models) if (DRAGGED.includes(tool.type)) tool.active = active
}

function middle_of({start, end}) {
  return (start + end) / 2
}

function zoom_time({zoom, shift}) {
  const range = model(waiting[0]).x_range, {start, end} = range
  if (zoom === "0") return range.reset()
  if (shift !== undefined) {
    const by = Number(shift) * (end - start)
    return range.setv({start: start + by, end: end + by})
  }
  const moment = cursor()
  const centre = moment !== null && start < moment && moment < end ? moment : middle_of(range)
  const half = Number(zoom) * (end - start) / 2
  range.setv({start: centre - half, end: centre + half})
}

function cursor() {
  for (const each of Bokeh.documents[0].all_models) {
    if (each.type === "Span" && each.dimension === "height") return each.visible ? each.location : null
  }
  return null
}

function zoom_path({zoom}) {
  for (const range of [model("path").x_range, model("path").y_range]) {
    if (zoom === "0") range.reset()
    else {
      const centre = middle_of(range), half = Number(zoom) * (range.end - range.start) / 2
      range.setv({start: centre - half, end: centre + half})
    }
  }
}

for (const [id, act] of [["time-zoom", zoom_time], ["path-zoom", zoom_path]]) {
  document.getElementById(id).addEventListener("click", ({target}) => {
    if (target.tagName === "BUTTON") act(target.dataset)
  })
}

const loading = setInterval(() => {
  if (Bokeh.documents.length === 0 || !Bokeh.documents[0].is_idle) return
  clearInterval(loading)
  if (innerWidth < NARROW) narrow()
  leave_fingers_to_the_page()
  let is_mouse = null
  addEventListener("pointerover", ({pointerType}) => {
    if (is_mouse === (pointerType === "mouse")) return
    is_mouse = pointerType === "mouse"
    use_tools(is_mouse)
  }, true)
  reveal()
}, 20)
