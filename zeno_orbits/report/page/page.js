"use strict";
// Draws the plots of the page from the data inside it. Nothing is fetched: the page has it all.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const byId = (id) => document.getElementById(id);
  const printed = window.matchMedia("print");
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const narrow = () => document.documentElement.clientWidth < 600;
  const touched = window.matchMedia("(pointer: coarse)");
  const level = { series: 0 };
  let colour = {};

  function readColours() {
    const style = getComputedStyle(document.documentElement);
    const names = ["paper", "ink", "soft", "line", "grid", "free", "locked", "law", "zeno", "release", "tint"];
    colour = Object.fromEntries(names.map((name) => [name, style.getPropertyValue("--" + name).trim()]));
  }

  // ------------------------------------------------------------------ looks

  function axis(title, more) {
    return {
      title: { text: title, standoff: 6 }, automargin: true, zeroline: false, showline: true,
      linecolor: colour.line, gridcolor: colour.grid, ticks: "outside", tickcolor: colour.line,
      exponentformat: "power", showexponent: "all", minexponent: 3, tickangle: 0, ...more,
    };
  }

  // A title in lines that are shorter than its axis, its unit in one piece.
  function folded(title, room) {
    const most = room / 8, seen = (text) => text.replace(/<[^>]*>/g, "").replace(/&\w+;/g, "x").length;
    const words = title.replace(/ (?=[^[\]]*\]$)/g, "\u00a0").split(" ");
    return words.reduce((text, word) => text + (seen(text.split("<br>").pop() + word) < most ? " " : "<br>") + word);
  }

  // A logarithmic axis over some values, with at most some six labels, all of them powers of ten.
  function decades(title, values, more) {
    const found = values.filter((value) => value > 0).map(Math.log10);
    const least = found.reduce((a, b) => Math.min(a, b), 0), most = found.reduce((a, b) => Math.max(a, b), least);
    return axis(title, { type: "log", dtick: Math.max(1, Math.ceil((most - least) / (narrow() ? 4 : 6))), ...more });
  }

  // A range that leaves a rim around all values of some traces.
  function around(traces, key) {
    const values = traces.flatMap((trace) => trace[key]).filter((value) => value !== null);
    const least = values.reduce((a, b) => Math.min(a, b)), most = values.reduce((a, b) => Math.max(a, b));
    const rim = 0.06 * (most - least) || 1;
    return [least - rim, most + rim];
  }

  function layout(more) {
    return {
      paper_bgcolor: colour.paper, plot_bgcolor: colour.paper, hovermode: "closest",
      font: { color: colour.ink, size: 13, family: "system-ui, sans-serif" },
      margin: { l: 10, r: 16, t: 32, b: 10 }, showlegend: false,
      // A finger that scrolls the page must not draw a frame.
      dragmode: touched.matches ? false : "zoom", ...more,
    };
  }

  const config = {
    displaylogo: false, responsive: true, showTips: false, scrollZoom: false,
    modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
  };

  function lineOf(kind) {
    if (kind === "locked") return { color: colour.locked, width: 4, simplify: false };
    if (kind === "tail") return { color: colour.free, width: 1.5, dash: "dot", simplify: false };
    return { color: colour.free, width: 2, simplify: false };
  }

  const wordOf = { free: "off the stop", locked: "on the stop", tail: "tail of the impacts" };

  function draw(name, traces, shape) {
    const place = byId("plot-" + name);
    if (!place) return;
    const { height = 340, ...rest } = shape;
    place.style.height = height + "px";
    Object.entries(rest).filter(([key]) => /^[xy]axis/.test(key)).forEach(([key, one]) => {
      const [low, high] = one.domain || [0, 1];
      const room = key[0] === "y" ? (high - low) * (height - 90) : place.clientWidth - 90;
      one.title.text = folded(one.title.text, room);
    });
    window.Plotly.react(place, traces, layout(rest), config);
  }

  // ------------------------------------------------------------------ plots

  function spots(points, name, marker) {
    return {
      x: points.x, y: points.y, mode: "markers", type: "scatter", name,
      marker: { color: colour.ink, ...marker }, hovertemplate: "%{x:.6g}, %{y:.6g}<extra>" + name + "</extra>",
    };
  }

  function drawPortraits() {
    (data.portraits || []).forEach((portrait, k) => {
      const traces = portrait.arcs.map((arc) => ({
        x: arc.x, y: arc.y, mode: "lines", type: "scatter", line: lineOf(arc.kind), name: wordOf[arc.kind] + arc.on,
        hovertemplate: "%{x:.6g}, %{y:.6g}<extra>" + wordOf[arc.kind] + arc.on + "</extra>",
      }));
      const { before, after } = portrait;
      const x = [], y = [];
      const join = (from, to) => from.x.forEach((value, i) => { x.push(value, to.x[i], null); y.push(from.y[i], to.y[i], null); });
      join(before, after);
      join(portrait.switch, portrait.reset);
      traces.push({ x, y, mode: "lines", type: "scatter", hoverinfo: "skip", line: { color: colour.soft, width: 1.2, dash: "dash" } });
      traces.push(spots(before, "before an impact", { symbol: "circle-open", size: 8, line: { width: 1.5 } }));
      traces.push(spots(after, "after an impact", { size: 4 }));
      traces.push(spots(portrait.release, "release", { symbol: "square-open", size: 12, color: colour.release, line: { width: 2.5 } }));
      if (portrait.switch.x.length) traces.push(spots(portrait.switch, "switch", { symbol: "diamond-open", size: 9, color: colour.release, line: { width: 2 } }));
      traces.push(spots(portrait.zeno, "Zeno point", { symbol: "star", size: 14, color: colour.zeno, line: { width: 1, color: colour.ink } }));
      draw("portrait-" + k, traces, {
        xaxis: axis(portrait.x, { range: around(traces, "x") }), yaxis: axis(portrait.y, { range: around(traces, "y") }),
      });
    });
  }

  function drawSeries() {
    const series = data.series;
    if (!series) return;
    const n = series.rows.length, traces = [], shape = { height: 130 * n + 90 };
    series.rows.forEach((row, k) => {
      const own = k === 0 ? "y" : "y" + (k + 1);
      const top = 1 - k / n, gap = 0.02;
      shape["yaxis" + (k === 0 ? "" : k + 1)] = axis(row.label, { domain: [Math.max(0, top - 1 / n) + (k === n - 1 ? 0 : gap), top], nticks: 5 });
      row.values.forEach((values, j) => {
        const kind = series.arcs[j].kind, name = wordOf[kind] + series.arcs[j].on;
        traces.push({
          x: series.arcs[j].t, y: values, mode: "lines", type: "scatter", xaxis: "x", yaxis: own,
          line: lineOf(kind), name, hovertemplate: "%{x:.9g} s: %{y:.6g}<extra>" + name + "</extra>",
        });
      });
    });
    shape.xaxis = axis("time since the start of the period [s]", { anchor: n === 1 ? "y" : "y" + n, nticks: narrow() ? 5 : 10 });
    shape.shapes = series.locked.map(([x0, x1]) => ({
      type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, fillcolor: colour.tint, line: { width: 0 }, layer: "below",
    }));
    series.impacts.slice(0, 200).forEach((x) => shape.shapes.push({
      type: "line", xref: "x", yref: "paper", x0: x, x1: x, y0: 0, y1: 1, layer: "below", line: { color: colour.soft, width: 1, dash: "dot" },
    }));
    series.switches.slice(0, 200).forEach((x) => shape.shapes.push({
      type: "line", xref: "x", yref: "paper", x0: x, x1: x, y0: 0, y1: 1, layer: "below", line: { color: colour.release, width: 1.5, dash: "dash" },
    }));
    draw("series", traces, shape);
    zoomTo("series");
  }

  function drawZeno(zeno, k) {
    const gapTitle = "gap h [" + zeno.unit + "]";
    const law = { color: colour.law, width: 2, dash: "dash", simplify: false };
    const flights = [
      ...zeno.arcs.map((arc) => ({ ...arc, line: lineOf(arc.kind), name: wordOf[arc.kind] })),
      ...zeno.tail.map((flight) => ({ ...flight, kind: "law", line: law, name: "by the law" })),
    ];
    const traces = flights.map((one) => ({
      x: one.t, y: one.h, mode: "lines", type: "scatter", line: one.line, name: one.name,
      hovertemplate: "%{x:.6g} s: %{y:.6g}<extra>" + one.name + "</extra>",
    }));
    traces.push(spots({ x: [0], y: [0] }, "Zeno point", { symbol: "star", size: 14, color: colour.zeno, line: { width: 1, color: colour.ink } }));
    draw("zeno-" + k, traces, { xaxis: axis("time from the Zeno point [s]", { nticks: narrow() ? 4 : 8 }), yaxis: axis(gapTitle), height: 400 });
    zoomTo("zeno-" + k);
    drawLogarithmic(zeno, k, flights, gapTitle, law);
  }

  function drawLogarithmic(zeno, k, all, gapTitle, law) {
    const left = "time left to the Zeno point [s]", reversed = { autorange: "reversed" };
    const flights = all.filter((one) => one.kind !== "locked" && one.t[0] < 0);
    // A gap of zero has no logarithm: every flight starts and ends at the floor.
    const floor = 0.02 * Math.min(...flights.map((one) => Math.max(...one.h)).filter((peak) => peak > 0));
    const traces = flights.map((one) => {
      const seen = one.t.map((t, i) => [-t, Math.max(one.h[i], floor)]).filter(([t]) => t > 0);
      return {
        x: seen.map((p) => p[0]), y: seen.map((p) => p[1]), mode: "lines", type: "scatter", line: one.line, name: one.name,
        hovertemplate: "%{x:.4g} s left: %{y:.4g}<extra>" + one.name + "</extra>",
      };
    });
    draw("gaps-" + k, traces, {
      xaxis: decades(left, traces.flatMap((one) => one.x), reversed), yaxis: decades(gapTitle, traces.flatMap((one) => one.y)),
    });
    const speeds = [
      { x: zeno.law.x, y: zeno.law.y, mode: "lines", type: "scatter", line: law, name: "first-order law", hoverinfo: "name" },
      { ...spots(zeno.speeds, "impact", { symbol: "circle-open", size: 9, line: { width: 1.8 } }), hovertemplate: "%{x:.6g} s left: %{y:.6g}<extra>impact</extra>" },
    ];
    draw("speeds-" + k, speeds, {
      xaxis: decades(left, [...zeno.law.x, ...zeno.speeds.x], reversed),
      yaxis: decades("speed of the impact [" + zeno.unit + "/s]", [...zeno.law.y, ...zeno.speeds.y]),
    });
  }

  function drawStability() {
    const found = data.stability;
    if (!found) return;
    const far = 1.25 * Math.max(1, ...found.re.map(Math.abs), ...found.im.map(Math.abs));
    draw("stability", [spots({ x: found.re, y: found.im }, "multiplier", { symbol: "x", size: 10, color: colour.locked })], {
      height: 400,
      xaxis: axis("real part [1]", { range: [-far, far], constrain: "domain" }),
      yaxis: axis("imaginary part [1]", { range: [-far, far], scaleanchor: "x" }),
      shapes: [{ type: "circle", x0: -1, x1: 1, y0: -1, y1: 1, line: { color: colour.ink, width: 1.5 }, fillcolor: "rgba(0,0,0,0)" }],
    });
  }

  function drawPushes() {
    (data.pushes || []).forEach((panel, k) => {
      const { lost, kept, step } = panel;
      const bars = {
        x: [...lost.x, ...kept.x], y: [...lost.y, ...kept.y], type: "bar", width: 0.8 * step, name: "returns",
        marker: { color: colour.free, opacity: 0.35 }, hoverinfo: "skip",
      };
      const ends = { ...spots(lost, "largest push", { size: 8, color: colour.locked }), text: lost.beyond };
      ends.hovertemplate = "phase %{x:.4g}: %{y:.6g}<extra>beyond: %{text}</extra>";
      const open = spots(kept, "end of the scan", { symbol: "circle-open", size: 8, line: { width: 1.5 } });
      draw("pushes-" + k, [bars, ends, open], {
        barmode: "overlay", xaxis: axis("phase [1]", { range: panel.range }),
        yaxis: axis(panel.label, { zeroline: true, zerolinecolor: colour.ink }),
        shapes: panel.contact.map((phase) => ({
          type: "rect", xref: "x", yref: "paper", x0: phase - step / 2, x1: phase + step / 2, y0: 0, y1: 1,
          fillcolor: colour.tint, line: { width: 0 }, layer: "below",
        })),
      });
    });
  }

  function drawTrade() {
    const found = data.trade;
    if (!found) return;
    const symbols = ["circle", "square", "diamond", "triangle-up", "triangle-down", "star", "cross", "x", "pentagon", "hexagon"];
    const hues = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", colour.soft, colour.ink];
    const traces = found.lines.map((line, k) => ({
      x: line.x, y: line.y, mode: "lines+markers", type: "scatter", name: line.name,
      line: { color: hues[k % hues.length], width: 1.5, dash: line.engine ? "solid" : "dot" },
      marker: { symbol: symbols[k % symbols.length] + (line.engine ? "" : "-open"), size: 8 },
      hovertemplate: "error %{x:.1e}, %{y:.3g} ms<extra>" + line.name + "</extra>",
    }));
    traces.unshift({ x: found.front.x, y: found.front.y, mode: "lines", type: "scatter", name: "nothing is faster and better", line: { color: colour.soft, width: 6 }, opacity: 0.4, hoverinfo: "skip" });
    draw("trade", traces, {
      height: narrow() ? 640 : 480, showlegend: true,
      legend: { orientation: "h", yref: "container", y: 0, yanchor: "bottom", font: { size: 12 } },
      xaxis: decades("relative error [1]", found.lines.flatMap((line) => line.x), { autorange: "reversed" }),
      yaxis: decades("processor time [ms]", found.lines.flatMap((line) => line.y)),
    });
  }

  // ------------------------------------------------------------------ machine

  // Draws the machine at a part of its period; between two pictures corners move straight.
  function showMachine(part) {
    const found = data.machine, n = found.modes.length, at = (part % 1) * n;
    const k = Math.floor(at), next = (k + 1) % n, rest = at - k, mode = found.modes[k];
    found.lines.forEach((line, j) => {
      const here = line.corners[k].map((value, i) => value + rest * (line.corners[next][i] - value));
      const shape = byId("machine").children[j];
      if (here.length === 2) {
        shape.setAttribute("cx", here[0]);
        shape.setAttribute("cy", -here[1]);
      } else {
        const corners = [];
        for (let i = 0; i < here.length; i += 2) corners.push(here[i] + "," + -here[i + 1]);
        shape.setAttribute("points", corners.join(" "));
      }
      shape.setAttribute("class", line.stop ? "stop" : mode);
    });
    byId("at").value = part;
    const digits = Math.max(0, 2 - Math.floor(Math.log10(found.period)));
    byId("shown").textContent = (part * found.period).toFixed(digits) + " s: " + wordOf[mode] + found.speed;
  }

  function startMachine() {
    const found = data.machine;
    if (!found) return;
    // A period is shown in two to ten seconds.
    const seconds = Math.min(10, Math.max(2, found.period)), slower = seconds / found.period;
    const times = Number(Math.max(slower, 1 / slower).toPrecision(2));
    found.speed = Math.abs(slower - 1) < 0.1 ? "" : ", shown " + times + " times " + (slower > 1 ? "slower" : "faster");
    let last = null;
    const step = (now) => {
      if (last === null) return;
      showMachine((Number(byId("at").value) + (now - last) / 1000 / seconds) % 1);
      last = now;
      requestAnimationFrame(step);
    };
    byId("play").addEventListener("click", () => {
      last = last === null ? performance.now() : null;
      byId("play").textContent = last === null ? "Play" : "Pause";
      if (last !== null) requestAnimationFrame(step);
    });
    byId("at").addEventListener("input", (event) => showMachine(Number(event.target.value)));
    showMachine(0);
  }

  // ------------------------------------------------------------------ zoom

  // Window of a plot at its present zoom: the first step leaves the whole motion, each other tenfold.
  function windowOf(name) {
    const k = level[name] || 0;
    if (name === "series") {
      const { zeno, end } = data.series, half = end * Math.pow(10, -k) / 2;
      return k === 0 || zeno === null ? [0, end] : [zeno - half, zeno + half];
    }
    const { length, start, end } = zenoOf(name);
    if (k === 0) return [start, end];
    const unit = length * Math.pow(10, 1 - k);
    return [-1.15 * unit, 0.35 * unit];
  }

  function zenoOf(name) {
    return data.zeno[Number(name.split("-")[1])];
  }

  function valuesIn(trace, low, high) {
    const seen = [];
    trace.x.forEach((x, i) => {
      const y = trace.y[i];
      if (x === null || y === null) return;
      if (x >= low && x <= high) seen.push(y);
      const x0 = trace.x[i - 1], y0 = trace.y[i - 1];
      // Where a line crosses an edge of the window.
      if (i > 0 && x0 !== null) [low, high].forEach((edge) => {
        if ((x0 - edge) * (x - edge) < 0) seen.push(y0 + (y - y0) * (edge - x0) / (x - x0));
      });
    });
    return seen;
  }

  function zoomTo(name) {
    const place = byId("plot-" + name), [low, high] = windowOf(name);
    const change = { "xaxis.range": [low, high] }, found = {};
    place.data.forEach((trace) => {
      const own = "yaxis" + (trace.yaxis || "y").slice(1);
      (found[own] = found[own] || []).push(...valuesIn(trace, low, high));
    });
    Object.entries(found).forEach(([own, values]) => {
      if (values.length === 0) return;
      const least = values.reduce((a, b) => Math.min(a, b)), most = values.reduce((a, b) => Math.max(a, b));
      const rim = 0.08 * (most - least) || 0.01 * Math.abs(most) || 1;
      change[own + ".range"] = [least - rim, most + rim];
    });
    window.Plotly.relayout(place, change);
    byId("window-" + name).textContent = "window: " + Number((high - low).toPrecision(2)) + " s";
    const most = deepest(name);
    document.querySelectorAll('button[data-plot="' + name + '"]').forEach((button) => {
      const step = button.dataset.zoom;
      button.disabled = step === "in" ? (level[name] || 0) >= most : !level[name];
    });
  }

  function deepest(name) {
    if (name === "series") return data.series.zeno === null ? 0 : data.series.decades;
    return 1 + Math.max(0, zenoOf(name).decades);
  }

  function onZoom(event) {
    const { plot, zoom } = event.currentTarget.dataset;
    const step = zoom === "in" ? 1 : -1;
    level[plot] = zoom === "all" ? 0 : Math.max(0, Math.min(deepest(plot), (level[plot] || 0) + step));
    zoomTo(plot);
  }

  // ------------------------------------------------------------------ start

  function drawAll() {
    readColours();
    drawPortraits();
    drawSeries();
    (data.zeno || []).forEach(drawZeno);
    drawStability();
    drawPushes();
    drawTrade();
  }

  async function unpack() {
    const packed = atob(byId("library").textContent.trim());
    const bytes = Uint8Array.from(packed, (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
  }

  async function start() {
    await unpack();
    startMachine();
    drawAll();
    document.querySelectorAll("button[data-plot]").forEach((button) => button.addEventListener("click", onZoom));
    dark.addEventListener("change", drawAll);
    printed.addEventListener("change", drawAll);
    document.documentElement.dataset.plots = "ready";
  }

  start().catch((error) => {
    byId("note").textContent = "The pictures cannot be drawn in this browser (" + error + "); all numbers and words are here.";
    document.documentElement.dataset.plots = "failed";
  });
})();
