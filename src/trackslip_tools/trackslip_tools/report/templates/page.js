// SPDX-FileCopyrightText: 2026 Trackslip authors
// SPDX-License-Identifier: Apache-2.0
// Light and dark theme, by the system's preference or the button. DARK maps the colours of the light page to
// those of the dark page.

const LIGHT = Object.fromEntries(Object.entries(DARK).map(([light, dark]) => [dark, light]))
const preference = matchMedia("(prefers-color-scheme: dark)")
let dark = preference.matches

function exchanged_colours(model, colours) {
  const changes = {}
  for (const name in model.properties) {
    if (!name.endsWith("_color")) continue
    const colour = colours[model[name]?.value ?? model[name]]
    if (colour !== undefined) changes[name] = colour
  }
  return changes
}

function paint() {
  document.documentElement.dataset.theme = dark ? "dark" : "light"
  for (const {all_models} of Bokeh.documents) {
    for (const model of all_models) model.setv(exchanged_colours(model, dark ? DARK : LIGHT))
  }
}

function choose(asDark) {
  dark = asDark
  paint()
}

document.getElementById("theme").addEventListener("click", () => choose(!dark))
preference.addEventListener("change", () => choose(preference.matches))
paint()
const first_painting = setInterval(() => {
  if (Bokeh.documents.length > 0) {
    clearInterval(first_painting)
    if (dark) paint()
  }
}, 20)
