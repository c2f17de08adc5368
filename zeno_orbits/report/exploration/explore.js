// Sliders and phase portraits of `zeno_orbits.explore`. Python computes, this file draws.
const WIDTH = 420, HEIGHT = 300, LEFT = 58, BOTTOM = 40, EDGE = 10;
const LEGEND = "Lines: blue flight, orange contact, purple end of an impact sequence, dashed reset. Points: yellow Zeno point, green release.";

function element(tag, name, parent, text = "") {
  const made = document.createElement(tag);
  made.className = name;
  made.textContent = text;
  parent.append(made);
  return made;
}

function drawn(tag, attributes, parent, text = "") {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  parent.append(made);
  return made;
}

function range(values) {
  const low = Math.min(...values), high = Math.max(...values);
  const edge = 0.05 * (high - low) || 0.05 * Math.abs(high) || 1;
  return [low - edge, high + edge];
}

function short(value) {
  return Number(value.toPrecision(4)).toString();
}

// About four round values inside a range: steps of 1, 2 or 5 times a power of ten.
function ticks(low, high) {
  const rough = (high - low) / 4, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= rough);
  const first = Math.ceil(low / step), last = Math.floor(high / step);
  return Array.from({ length: last - first + 1 }, (_, k) => (first + k) * step);
}

function panel(parent, data) {
  const svg = drawn("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}` }, parent);
  const all = [...data.paths.map((path) => path.points), ...data.resets, data.zeno, data.release].flat();
  const [x0, x1] = range(all.map((point) => point[0]));
  const [y0, y1] = range(all.map((point) => point[1]));
  const across = (x) => LEFT + ((x - x0) / (x1 - x0)) * (WIDTH - LEFT - EDGE);
  const up = (y) => HEIGHT - BOTTOM - ((y - y0) / (y1 - y0)) * (HEIGHT - BOTTOM - EDGE);
  const line = (points) => points.map(([x, y]) => `${across(x).toFixed(1)},${up(y).toFixed(1)}`).join(" ");
  drawn("rect", { class: "axis", x: LEFT, y: EDGE, width: WIDTH - LEFT - EDGE, height: HEIGHT - BOTTOM - EDGE }, svg);
  for (const x of ticks(x0, x1))
    drawn("text", { x: across(x), y: HEIGHT - BOTTOM + 14, "text-anchor": "middle" }, svg, short(x));
  for (const y of ticks(y0, y1)) drawn("text", { x: LEFT - 5, y: up(y) + 4, "text-anchor": "end" }, svg, short(y));
  drawn("text", { x: (LEFT + WIDTH) / 2, y: HEIGHT - 6, "text-anchor": "middle" }, svg, data.x);
  drawn("text", { x: 12, y: HEIGHT / 2, "text-anchor": "middle", transform: `rotate(-90 12 ${HEIGHT / 2})` }, svg, data.y);
  for (const path of data.paths) drawn("polyline", { class: path.kind, points: line(path.points) }, svg);
  for (const reset of data.resets) drawn("polyline", { class: "reset", points: line(reset) }, svg);
  for (const [x, y] of data.zeno) drawn("circle", { class: "zeno", cx: across(x), cy: up(y), r: 5 }, svg);
  for (const [x, y] of data.release)
    drawn("rect", { class: "release", x: across(x) - 4, y: up(y) - 4, width: 8, height: 8 }, svg);
}

function render({ model, el }) {
  const root = element("div", "zeno-explore", el);
  const sliders = element("div", "sliders", root);
  const name = element("div", "name", root);
  const facts = element("div", "facts", root);
  const panels = element("div", "panels", root);
  element("div", "legend", root, LEGEND);
  const inputs = {};
  let sent = null, waiting = false;

  function send() {
    sent = Object.fromEntries(Object.entries(inputs).map(([key, input]) => [key, Number(input.value)]));
    waiting = false;
    model.set("values", sent);
    model.save_changes();
  }

  for (const slider of model.get("sliders")) {
    const row = element("label", "slider", sliders);
    row.title = slider.meaning;
    element("span", "", row, `${slider.name} [${slider.unit}]`);
    const input = element("input", "", row);
    Object.assign(input, { type: "range", min: slider.lower, max: slider.upper, step: "any" });
    input.value = model.get("values")[slider.name];
    input.dataset.name = slider.name;
    const shown = element("span", "", row, short(Number(input.value)));
    input.addEventListener("input", () => {
      shown.textContent = Number(Number(input.value).toPrecision(5)).toString();
      // One question at a time: the newest values are sent when the last answer has arrived.
      if (sent === null) send();
      else waiting = true;
    });
    inputs[slider.name] = input;
  }

  function show() {
    const view = model.get("view");
    name.textContent = `${view.title}: ${view.name}`;
    facts.replaceChildren();
    for (const [label, value] of view.facts) {
      const fact = element("span", "", facts);
      element("b", "", fact, `${label} `);
      fact.append(value);
    }
    panels.replaceChildren();
    for (const data of view.panels) panel(panels, data);
    root.dataset.seconds = view.seconds;
    sent = null;
    if (waiting) send();
  }

  model.on("change:view", show);
  show();
  return () => model.off("change:view", show);
}

export default { render };
