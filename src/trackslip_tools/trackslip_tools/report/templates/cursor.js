// SPDX-FileCopyrightText: 2026 Trackslip authors
// SPDX-License-Identifier: Apache-2.0
// Shows one time in all plots. Arguments from Bokeh: cb_obj, the mouse event; spans, the vertical lines in the
// plots over time; paths (t, x, y, heading) and markers (x, y, heading), one for each run; on_path, whether
// the mouse is over the path plot.

function nearestOnPath(x, y) {
  let best = Infinity, time = null
  for (const {data} of paths) {
    for (let i = 0; i < data.t.length; i++) {
      const distance = (data.x[i] - x) ** 2 + (data.y[i] - y) ** 2
      if (distance < best) [best, time] = [distance, data.t[i]]
    }
  }
  return time
}

function lastBefore(times, time) {
  let low = 0, high = times.length - 1
  while (low < high) {
    const middle = (low + high + 1) >> 1
    if (times[middle] <= time) low = middle
    else high = middle - 1
  }
  return low
}

const time = on_path ? nearestOnPath(cb_obj.x, cb_obj.y) : cb_obj.x
if (time !== null) {
  for (const span of spans) span.setv({location: time, visible: true})
  paths.forEach(({data}, run) => {
    const i = lastBefore(data.t, time)
    markers[run].data = {x: [data.x[i]], y: [data.y[i]], heading: [data.heading[i]]}
  })
}
