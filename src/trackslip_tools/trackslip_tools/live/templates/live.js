// SPDX-FileCopyrightText: 2026 Trackslip authors
// SPDX-License-Identifier: Apache-2.0
// Shows the frames of the server. Their contents are inserted as text or numbers, never as HTML, and the page
// sends nothing.

const PATIENCE = 2000 // ms since the last frame, after which the page turns grey
const WATCH = 250 // ms between these checks
const GIVEN_UP = 5000 // ms without a frame after which the page reconnects
const RETRY = 500 // ms between attempts
const KEPT = 1920 // rows kept by the strips
const LEVELS = ["ok", "warn", "error", "stale", "silent"]
const WORDS = ["✓ ok", "▲ warning", "✖ error", "◌ no data", "✖ silent"]
const MARGIN = 1 // m around the path
const CLOSEST = 2, WIDEST = 2000 // m, limits of the displayed width
const EVENTS = 200
const DRAWN = 3 // frames per drawing of the strips
const NARROW = 760, LOW = 340 // pixels: on a narrow page the path is lower

const by_id = id => document.getElementById(id)
let models = null // function: name -> Bokeh model
let run = null, number = 0, event_number = 0
let shown = performance.now(), shown_at = null // time of the last frame: here; on the vehicle's clock
let window_ms = 60000, across = null // across: m displayed around the machine; null: the whole path
let bounds = [Infinity, Infinity, -Infinity, -Infinity], machine = [[], []], views = []
let lines = [], strips = [] // strips: {lines, rows to draw, whether the strip is in view}

async function begin() {
  setInterval(watch, WATCH)
  document.addEventListener("visibilitychange", watch) // browsers slow down the timers of hidden pages
  const page = await fetch_description()
  const id = "live"
  const roots = Object.fromEntries(Object.entries(page.plots).map(([element, model]) => [model, element]))
  await Bokeh.embed.embed_items({[id]: page.document}, [{docid: id, roots, root_ids: Object.keys(roots)}])
  const drawn = Bokeh.documents[0]
  models = name => drawn.get_model_by_name(name)
  lines = page.lines.map((_, k) => models(`line-${k}`))
  strips = Array.from({length: page.panels}, (_, panel) =>
    ({panel, lines: page.lines.flatMap((line, k) => line.panel === panel ? [k] : []), rows: [], in_view: false}))
  watch_strips()
  if (innerWidth < NARROW) {
    models("path").height = LOW
    for (const name in page.plots) if (models(name).title !== null) models(name).title.text_font_size = "12px"
  }
  connect()
}

async function fetch_description() {
  for (;;) {
    try {
      const answer = await fetch("page.json")
      if (answer.ok) return await answer.json()
    } catch {} // the server does not answer yet
    await new Promise(resolve => setTimeout(resolve, RETRY))
  }
}

let socket = null, connected = 0

function connect() {
  connected = performance.now()
  const secure = location.protocol === "https:"
  const mine = socket = new WebSocket(`${secure ? "wss" : "ws"}://${location.host}/stream`)
  mine.onmessage = ({data}) => { if (mine === socket) show(JSON.parse(data)) }
  mine.onclose = () => setTimeout(() => { if (mine === socket) connect() }, RETRY)
}

function watch() {
  const now = performance.now(), quiet = now - shown
  if (quiet > PATIENCE) {
    document.body.classList.add("outdated")
    const since = shown_at === null ? "" : ` since ${clock(shown_at)}`
    show_link("silent", `no data${since} (${Math.floor(quiet / 1000)} s)`)
  }
  const connects = socket !== null && socket.readyState === WebSocket.CONNECTING // a busy server needs longer
  if (socket !== null && now - Math.max(shown, connected) > (connects ? 3 : 1) * GIVEN_UP) {
    socket.close()
    connect()
  }
}

function show_link(state, text) {
  const link = by_id("link")
  link.className = `light ${state}`
  if (link.textContent !== text) link.textContent = text
}

function show(frame) {
  if (frame.run !== undefined) show_whole(frame)
  else if (frame.number <= number || run === null) return
  else show_news(frame)
  number = frame.number
  show_now(frame)
  shown = performance.now()
  shown_at = frame.time
  document.body.classList.remove("outdated")
  if (frame.ended === undefined) show_link("ok", "live")
  else show_link("ended", frame.ended)
  document.documentElement.dataset.frames = String(Number(document.documentElement.dataset.frames ?? 0) + 1)
}

// Curves, path and fixes

const numbers = values => Float64Array.from(values, value => value ?? NaN)

function fill(name, [x, y]) {
  models(name).data = {x, y}
}

function show_whole(frame) {
  if (frame.run !== run) by_id("events").replaceChildren()
  if (frame.run !== run) event_number = 0
  run = frame.run
  by_id("source").textContent = frame.source
  const t = numbers(frame.times)
  lines.forEach((line, k) => {
    const [value, low, high] = [0, 1, 2].map(part => numbers(frame.rows.map(row => row[k][part])))
    line.data = has_band(line) ? {t, value, low, high} : {t, value}
  })
  for (const strip of strips) strip.rows = []
  show_trail(frame.trail)
  fill("fixes", [frame.fixes.map(([x]) => x), frame.fixes.map(([, y]) => y)])
}

const has_band = line => "low" in line.data

function show_trail(points) {
  bounds = [Infinity, Infinity, -Infinity, -Infinity]
  points.forEach(widen)
  fill("trail", [points.map(([x]) => x), points.map(([, y]) => y)])
}

function widen([x, y]) {
  bounds = [Math.min(bounds[0], x), Math.min(bounds[1], y), Math.max(bounds[2], x), Math.max(bounds[3], y)]
}

function watch_strips() {
  const watcher = new IntersectionObserver(entries => {
    for (const {target, isIntersecting} of entries) strips[Number(target.id.split("-")[1])].in_view = isIntersecting
  }, {rootMargin: "400px"})
  for (const {panel} of strips) watcher.observe(by_id(`strip-${panel}`))
}

// Draws the strips in view; called with every third frame, because drawing dominates the load
function show_strips(time, all) {
  for (const strip of strips) {
    if (!strip.in_view && !all) continue
    for (const k of strip.lines) lines[k].stream(columns(strip.rows, k), KEPT)
    strip.rows = []
    if (views[strip.panel] !== undefined) {
      const [start, end] = views[strip.panel]
      models(`range-${strip.panel}`).setv({start, end})
    }
    models(`time-${strip.panel}`).setv({start: time - window_ms, end: time})
  }
}

function columns(rows, k) {
  const [value, low, high] = [0, 1, 2].map(part => rows.map(({row}) => row[k][part] ?? NaN))
  const t = rows.map(({time}) => time)
  return has_band(lines[k]) ? {t, value, low, high} : {t, value}
}

function show_news(frame) {
  for (const strip of frame.ended === undefined ? strips : []) {
    strip.rows.push({time: frame.time, row: frame.row})
    if (strip.rows.length > KEPT) strip.rows.shift()
  }
  if (frame.trail !== undefined) show_trail(frame.trail)
  else if (frame.path !== undefined) {
    widen(frame.path)
    models("trail").stream({x: [frame.path[0]], y: [frame.path[1]]})
  }
  if (frame.new_fixes !== undefined) {
    const [x, y] = [0, 1].map(axis => frame.new_fixes.map(fix => fix[axis]))
    models("fixes").stream({x, y}, 400)
  }
}

// Data that every frame contains in full

function show_now(frame) {
  by_id("clock").textContent = clock(frame.time)
  for (const [name, text] of Object.entries(frame.facts)) {
    const element = document.querySelector(`[data-fact="${name}"]`)
    if (element !== null && element.textContent !== text) element.textContent = text
  }
  for (const [name, outline] of Object.entries(frame.outlines)) fill(name, outline)
  if (frame.views !== undefined) views = frame.views
  const is_whole = frame.run !== undefined
  if (frame.number % DRAWN === 0 || is_whole) show_strips(frame.time, is_whole)
  if (frame.outlines.machine[0].length) machine = frame.outlines.machine
  update_view()
  show_setup(frame.setup)
  show_lights(frame.lights)
  show_classes(frame.classes)
  show_events(frame.events)
  show_gauges(frame.row)
}

const clock = ms => new Date(ms).toISOString().slice(11, 19)

function middle(low, high) {
  return (low + high) / 2
}

function update_view() {
  const plot = models("path")
  const [width, height] = [plot.inner_width, plot.inner_height]
  if (!width || !height) return
  const [x, y] = machine, all = across === null ? bounds : []
  const [left, right] = [Math.min(...x, ...all.slice(0, 1)), Math.max(...x, ...all.slice(2, 3))]
  const [low, high] = [Math.min(...y, ...all.slice(1, 2)), Math.max(...y, ...all.slice(3))]
  if (!Number.isFinite(left)) return
  const centre = [middle(left, right), middle(low, high)]
  const metres_x = across ?? right - left + 2 * MARGIN
  const metres_y = across === null ? high - low + 2 * MARGIN : 0
  const half_x = Math.max(metres_x, metres_y * width / height) / 2
  const half_y = half_x * height / width
  plot.x_range.setv({start: centre[0] - half_x, end: centre[0] + half_x})
  plot.y_range.setv({start: centre[1] - half_y, end: centre[1] + half_y})
}

function zoom(factor) {
  const {start, end} = models("path").x_range
  across = Math.min(Math.max((across ?? end - start) * factor, CLOSEST), WIDEST)
  update_view()
}

// Lists

function fit_children(list, count, make) {
  while (list.children.length > count) list.lastChild.remove()
  while (list.children.length < count) list.append(make())
  return [...list.children]
}

function element(tag, name, ...children) {
  const made = document.createElement(tag)
  if (name) made.className = name
  made.append(...children)
  return made
}

const light_item = () => element("li", "light",
  element("b", "", element("span", "name"), element("span", "state")), element("small", "reason"), element("small", "numbers"))

function show_setup(text) {
  const banner = by_id("setup")
  banner.hidden = !text
  if (banner.textContent !== text) banner.textContent = text
}

function show_lights(lights) {
  fit_children(by_id("lights"), lights.length, light_item).forEach((item, k) => {
    const [name, level, message, rate, age] = lights[k]
    const parts = [rate === null ? "" : `${rate.toFixed(1)} Hz`, age === null ? "" : `${age.toFixed(1)} s ago`]
    const texts = {name, state: WORDS[level], reason: message, numbers: parts.filter(Boolean).join(" · ")}
    item.className = `light ${LEVELS[level]}`
    for (const [part, text] of Object.entries(texts)) item.querySelector(`.${part}`).textContent = text
  })
}

function show_classes(classes) {
  fit_children(by_id("classes"), classes.length, () => element("li", "", element("span"), element("span"))).forEach((item, k) => {
    const [name, chance, is_certain] = classes[k]
    item.className = is_certain ? "certain" : ""
    const mark = k === 0 && !is_certain ? "undetermined; likeliest: " : ""
    item.firstChild.textContent = mark + name.replaceAll("_", " ")
    item.lastChild.textContent = chance === null ? "–" : `${(100 * chance).toFixed(0)} %`
  })
}

function show_events(events) {
  const list = by_id("events")
  for (const [index, time, level, text] of events) {
    if (index <= event_number) continue
    event_number = index
    list.prepend(element("li", LEVELS[level], element("time", "", clock(time)), text))
  }
  while (list.children.length > EVENTS) list.lastChild.remove()
}

// Bars

function show_gauges(row) {
  for (const gauge of document.querySelectorAll(".gauge")) {
    const [value, low, high] = row[gauge.dataset.line]
    const range = gauge.dataset.low === undefined ? views[gauge.dataset.panel] : [gauge.dataset.low, gauge.dataset.high].map(Number)
    gauge.classList.toggle("unknown", value === null || range === undefined)
    gauge.querySelector(".number").textContent = text_of(value, low, high, gauge.dataset.unit)
    if (value === null || range === undefined) continue
    const share = v => 100 * Math.min(Math.max((v - range[0]) / (range[1] - range[0]), 0), 1)
    stretch(gauge.querySelector(".fill"), share(Math.min(value, 0)), share(Math.max(value, 0)))
    const known = low !== null && high !== null
    stretch(gauge.querySelector(".interval"), share(known ? low : value), share(known ? high : value))
    gauge.querySelector(".zero").style.left = `calc(${share(0)}% - 1px)`
  }
}

function stretch(bar, from, to) {
  bar.style.left = `${from}%`
  bar.style.width = `${Math.max(to - from, 0)}%`
}

function text_of(value, low, high, unit) {
  if (value === null) return "–"
  const known = low !== null && high !== null
  const half = known ? (high - low) / 2 : 0
  const digits = Math.abs(value) >= 100 ? 0 : 1
  const even = known && Math.abs(high + low - 2 * value) < 0.02 * (high - low)
  const spread = !known ? "" : even ? ` ± ${half.toFixed(digits)}` : ` (${low.toFixed(digits)} to ${high.toFixed(digits)})`
  return `${value.toFixed(digits)}${spread} ${unit}`
}

// Buttons

by_id("closer").addEventListener("click", () => zoom(1 / 1.6))
by_id("wider").addEventListener("click", () => zoom(1.6))
by_id("all").addEventListener("click", () => { across = null; update_view() })
by_id("windows").addEventListener("click", ({target}) => {
  if (target.dataset.seconds === undefined) return
  window_ms = 1000 * Number(target.dataset.seconds)
  for (const button of by_id("windows").children) button.classList.toggle("chosen", button === target)
})
begin()
