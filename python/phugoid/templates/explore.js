/* Time histories that can be looked into: drag to zoom all panels, point at a sample to read it everywhere, and a map of one
   residual over two variables, which shows the samples in view. Without script, and in print, the picture is shown instead. */
"use strict";
const STYLE = getComputedStyle(document.documentElement), LEFT = 54, RIGHT = 8, FOOT = 16, MAP = 300;
const colour = name => STYLE.getPropertyValue("--" + name);
const number = x => x == null ? "missing" : String(Number(x.toPrecision(4)));

function add(parent, tag, kind, text) {
  const made = document.createElement(tag);
  made.className = kind;
  if (text) made.textContent = text;
  return parent.appendChild(made);
}

/* At least two, for one alone gives no scale. */
function ticks(low, high, most) {
  const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
  const steps = [0.2, 0.5, 1, 2, 5, 10].map(m => m * power), at = steps.findIndex(s => s >= rough);
  for (const step of steps.slice(0, at + 1).reverse()) {
    const found = [];
    for (let i = Math.ceil(low / step); i * step <= high; i++) found.push(Number((i * step).toPrecision(12)));
    if (found.length > 1) return found;
  }
  return [];
}

function range(values, from, to, also) {
  let low = also ? -also : Infinity, high = also || -Infinity;
  for (const v of values) for (let i = from; i <= to; i++) if (v[i] != null) {
    if (v[i] < low) low = v[i];
    if (v[i] > high) high = v[i];
  }
  if (!(low <= high)) return [0, 1];
  const room = 0.06 * (high - low) || 0.1 * Math.abs(high) || 1;
  return [low - room, high + room];
}

function prepare(canvas) {
  const ratio = window.devicePixelRatio || 1, g = canvas.getContext("2d");
  canvas.width = canvas.clientWidth * ratio;
  canvas.height = canvas.clientHeight * ratio;
  g.scale(ratio, ratio);
  g.font = "11px system-ui, sans-serif";
  return g;
}

/* Draws a frame with its ticks; returns how values become pixels. */
function frame(g, [x0, x1], [y0, y1], left, top, width, height, most, withTime) {
  const x = v => left + (v - x0) / (x1 - x0) * width, y = v => top + height - (v - y0) / (y1 - y0) * height;
  g.fillStyle = colour("quiet");
  g.strokeStyle = colour("line");
  g.lineWidth = 1;
  g.beginPath();
  g.textAlign = "right";
  for (const v of ticks(y0, y1, most)) {
    g.moveTo(left, y(v));
    g.lineTo(left + width, y(v));
    g.fillText(String(v), left - 4, y(v) + 4);
  }
  g.stroke();
  g.textAlign = "center";
  if (withTime) for (const v of ticks(x0, x1, Math.max(2, width / 70))) g.fillText(String(v), x(v), top + height + 13);
  return [x, y];
}

function line(g, t, v, from, to, x, y, name, hold) {
  g.strokeStyle = g.fillStyle = colour(name);
  g.lineWidth = name === "model" ? 1.5 : 1;
  g.beginPath();
  let drawing = false;
  for (let i = from; i <= to; i++) {
    if (v[i] == null) { drawing = false; continue; }
    const px = x(t[i]), py = y(v[i]);
    if (name === "measured") { g.moveTo(px + 1.3, py); g.arc(px, py, 1.3, 0, 7); continue; }
    if (drawing && hold) g.lineTo(px, y(v[i - 1]));
    if (drawing) g.lineTo(px, py); else g.moveTo(px, py);
    drawing = true;
  }
  if (name === "measured") g.fill(); else g.stroke();
}

function explore(box, data) {
  box.closest("figure").classList.add("live");
  const t = data.t, values = data.values, whole = [t[0], t[t.length - 1]];
  let span = whole, at = -1, drag = null;
  const index = time => {
    let a = 0, b = t.length - 1;
    while (b - a > 1) { const m = (a + b) >> 1; if (t[m] < time) a = m; else b = m; }
    return time - t[a] < t[b] - time ? a : b;
  };
  const bar = add(box, "p", "bar"), back = add(bar, "button", "", "Whole record");
  const told = add(bar, "span", "quiet", data.note);
  back.onclick = () => { span = whole; redraw(); };
  const keys = add(box, "p", "keys quiet");
  for (const kind of new Set(data.panels.flatMap(p => [...p.lines.map(l => l[1]), ...(p.residual ? ["residual"] : [])])))
    add(keys, "span", kind, kind === "residual" ? "residual (grey: ±2σ)" : kind);
  const grid = add(box, "div", "panels");
  const panels = data.panels.map(p => {
    const cell = add(grid, "div", "panel"), head = add(cell, "div", "head"), canvas = add(cell, "canvas", p.residual ? "tall" : "");
    add(head, "b", "", p.title);
    const panel = { ...p, canvas, said: add(head, "span", "quiet") };
    const time = e => span[0] + (e.offsetX - LEFT) / (canvas.clientWidth - LEFT - RIGHT) * (span[1] - span[0]);
    canvas.onpointerdown = e => { drag = [time(e), time(e)]; canvas.setPointerCapture(e.pointerId); };
    canvas.onpointermove = e => { at = index(time(e)); if (drag) drag[1] = time(e); redraw(); };
    canvas.onpointerup = () => {
      const [a, b] = drag ? drag.map(v => Math.min(Math.max(v, span[0]), span[1])).sort((p, q) => p - q) : [0, 0];
      if (b - a > 0.01 * (span[1] - span[0])) span = [a, b];
      drag = null;
      redraw();
    };
    canvas.onpointercancel = () => { drag = null; };
    canvas.onpointerleave = () => { if (!drag) { at = -1; redraw(); } };
    canvas.ondblclick = () => { span = whole; redraw(); };
    return panel;
  });
  const map = data.residuals.length && data.variables.length > 1 ? regimes() : null;

  function regimes() {
    const cell = add(box, "div", "map"), head = add(cell, "p", "head"), chosen = {};
    add(head, "b", "", "Residual");
    for (const [kind, names, first, before] of [["r", data.residuals, data.first, " of "], ["x", data.variables, data.over[0], " over "],
      ["y", data.variables, data.over[1], " (horizontal) and "]]) {
      head.append(before);
      const select = chosen[kind] = add(head, "select", "");
      for (const name of names) select.add(new Option(data.labels[name], name, false, name === first));
      select.onchange = () => redraw();
    }
    head.append(" (vertical)");
    const canvas = add(cell, "canvas", "square");
    add(cell, "p", "quiet", "Each point is a sample; blue where the residual is negative, orange where it is positive; its size grows to twice the "
      + "RMS. Samples that are not in view above are pale.");
    let places = [];
    canvas.onpointermove = e => {
      let best = 400;
      at = -1;
      places.forEach(([px, py], i) => { const d = (px - e.offsetX) ** 2 + (py - e.offsetY) ** 2; if (d < best) { best = d; at = i; } });
      redraw();
    };
    canvas.onpointerleave = () => { at = -1; redraw(); };
    return () => {
      const [r, u, v] = ["r", "x", "y"].map(k => values[chosen[k].value]), last = t.length - 1;
      const present = r.filter(e => e != null), rms = Math.sqrt(present.reduce((s, e) => s + e * e, 0) / present.length) || 1;
      const g = prepare(canvas), width = canvas.clientWidth - LEFT - RIGHT;
      const [x, y] = frame(g, range([u], 0, last), range([v], 0, last), LEFT, 18, width, MAP - 2 * FOOT - 18, 6, true);
      g.textAlign = "left";
      g.fillText(data.labels[chosen.y.value], 4, 11);
      g.textAlign = "right";
      g.fillText(data.labels[chosen.x.value], LEFT + width, MAP - 4);
      places = [];
      for (let i = 0; i <= last; i++) {
        if (r[i] == null || u[i] == null || v[i] == null) { places.push([-1e9, 0]); continue; }
        places.push([x(u[i]), y(v[i])]);
        g.globalAlpha = t[i] >= span[0] && t[i] <= span[1] ? 0.85 : 0.08;
        g.fillStyle = colour(r[i] < 0 ? "measured" : "model");
        g.beginPath();
        g.arc(...places[i], 0.8 + 2.2 * Math.min(1, Math.abs(r[i]) / (2 * rms)), 0, 7);
        g.fill();
      }
      g.globalAlpha = 1;
      if (at >= 0 && places[at]) { g.strokeStyle = colour("ink"); g.beginPath(); g.arc(...places[at], 7, 0, 7); g.stroke(); }
    };
  }

  function draw(p) {
    const g = prepare(p.canvas), width = p.canvas.clientWidth - LEFT - RIGHT, height = p.canvas.clientHeight - FOOT;
    const from = Math.max(0, index(span[0]) - 1), to = Math.min(t.length - 1, index(span[1]) + 1);
    const strip = p.residual ? 40 : 0, main = height - 4 - (strip ? strip + 6 : 0);
    g.save();
    const parts = [[p.lines, 4, main, 5, 0]];
    if (strip) parts.push([[[p.residual, "residual"]], height - strip, strip, 3, p.band]);
    for (const [lines, top, high, most, band] of parts) {
      const shown = lines.map(([key]) => values[key]);
      const [x, y] = frame(g, span, range(shown, from, to, band), LEFT, top, width, high, most, top + high >= height);
      g.save();
      g.beginPath();
      g.rect(LEFT, top, width, high);
      g.clip();
      if (band) { g.fillStyle = colour("band"); g.fillRect(LEFT, y(band), width, y(-band) - y(band)); }
      lines.forEach(([key, name, hold]) => line(g, t, values[key], from, to, x, y, name, hold));
      if (drag) { g.fillStyle = colour("chosen"); g.fillRect(x(drag[0]), top, x(drag[1]) - x(drag[0]), high); }
      if (at >= 0) { g.fillStyle = colour("ink"); g.fillRect(x(t[at]) - 0.5, top, 1, high); }
      g.restore();
    }
    g.restore();
    const keys = [...p.lines, ...(p.residual ? [[p.residual, "residual"]] : [])];
    p.said.textContent = at < 0 ? "" : keys.map(([key, name]) => `${name} ${number(values[key][at])}`).join(", ");
  }

  function redraw() {
    panels.forEach(draw);
    if (map) map();
    back.disabled = span === whole;
    told.textContent = at < 0 ? data.note : `at ${number(t[at])} ${data.unit}`;
  }
  /* What is told while the pointer is over a panel is shorter than the note: nothing below shall move. */
  const reserve = () => {
    told.textContent = data.note;
    bar.style.minHeight = "";
    bar.style.minHeight = bar.offsetHeight + "px";
    redraw();
  };
  new ResizeObserver(() => requestAnimationFrame(reserve)).observe(box);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}

for (const box of document.querySelectorAll(".explore")) explore(box, JSON.parse(box.querySelector("script").textContent));
