"use strict";
// Pictures of one joint at a time, as SVG; each can be zoomed along its abscissa.

const { joints, inks, first } = JSON.parse(document.getElementById("data").textContent);
const CURVES = {
  today: ["simulator as it stands", "#f0a573"],
  corrected: ["its own numbers corrected", "#8c8c8c", "hidden"],
  after: ["with the findings", "#08519c"],
};
const GREY = "#b4b4b4";
const MARGIN = { left: 52, right: 8, top: 8, bottom: 34 };
const all = (selector, root = document) => [...root.querySelectorAll(selector)];
const words = (id) => id.replaceAll("_", " ");

function make(tag, attributes, parent, text) {
  const svg = ["svg", "path", "line", "rect", "text"].includes(tag);
  const node = svg
    ? document.createElementNS("http://www.w3.org/2000/svg", tag)
    : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  if (text !== undefined) node.textContent = text;
  parent.append(node);
  return node;
}

/** Round numbers between two ends, about as many as wanted. */
function ticks(low, high, wanted) {
  const rough = (high - low) / wanted;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((k) => k * power >= rough);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found;
}

const written = (x) => String(+x.toPrecision(6)).replace("-", "−");

/** Smallest and largest of finite numbers, with a little room. */
function ends(values, room) {
  let low = Infinity, high = -Infinity;
  for (const x of values) if (x !== null) { low = Math.min(low, x); high = Math.max(high, x); }
  if (low > high) return [-1, 1];
  const more = high > low ? room * (high - low) : 1e-3 + 0.1 * Math.abs(high);
  return [low - more, high + more];
}

class Plot {
  /** layers: {x, y, ink, dots}; axes: names with units; floor: noise, marks: {x, name}. */
  constructor(parent, { layers, axes, height, floor = 0, marks = [] }) {
    Object.assign(this, { layers, axes, height, floor, marks });
    this.host = make("div", { class: "plot", tabindex: 0 }, parent);
    this.whole = ends(layers.flatMap((l) => l.x), layers.some((l) => l.dots) ? 0.03 : 0);
    this.range = this.whole;
    this.host.addEventListener("keydown", (event) => this.key(event));
    this.host.addEventListener("dblclick", () => this.zoom(...this.whole));
    this.host.addEventListener("pointerdown", (event) => this.drag(event));
  }

  get zoomed() { return this.range !== this.whole; }

  zoom(low, high) {
    const [first, last] = this.whole;
    low = Math.max(first, low);
    high = Math.min(last, high);
    if (!(high - low > 1e-6 * (last - first))) return;
    this.range = low === first && high === last ? this.whole : [low, high];
    this.draw();
    offerWhole();
  }

  key(event) {
    const [low, high] = this.range, span = high - low;
    const moves = {
      "+": [0.2, -0.2], "=": [0.2, -0.2], "-": [-0.3, 0.3],
      ArrowLeft: [-0.2, -0.2], ArrowRight: [0.2, 0.2],
    };
    if (event.key === "0") this.zoom(...this.whole);
    const move = moves[event.key];
    if (!move) return;
    event.preventDefault();
    const shift = [low + move[0] * span, high + move[1] * span];
    const inside = shift[0] >= this.whole[0] && shift[1] <= this.whole[1];
    if (event.key.startsWith("Arrow") && !inside) return;
    this.zoom(...shift);
  }

  drag(down) {
    const svg = this.host.firstChild, frame = svg.getBoundingClientRect();
    const scale = this.width / frame.width;
    const at = (event) => {
      const x = (event.clientX - frame.left) * scale;
      return Math.min(this.width - MARGIN.right, Math.max(MARGIN.left, x));
    };
    const from = at(down);
    const box = make("rect", { class: "box", y: MARGIN.top, width: 0, x: from,
      height: this.height - MARGIN.top - MARGIN.bottom }, svg);
    svg.setPointerCapture(down.pointerId);
    svg.onpointermove = (event) => {
      box.setAttribute("x", Math.min(from, at(event)));
      box.setAttribute("width", Math.abs(at(event) - from));
    };
    svg.onpointercancel = () => { box.remove(); svg.onpointermove = null; };
    svg.onpointerup = (event) => {
      svg.onpointercancel();
      const to = at(event);
      if (Math.abs(to - from) > 6) {
        this.zoom(this.value(Math.min(from, to)), this.value(Math.max(from, to)));
      }
    };
  }

  value(pixel) {
    const [low, high] = this.range;
    const inner = this.width - MARGIN.left - MARGIN.right;
    return low + ((pixel - MARGIN.left) / inner) * (high - low);
  }

  draw() {
    this.width = Math.round(this.host.clientWidth) || 640;
    const { width, height, range: [low, high] } = this;
    const shown = this.layers.filter((l) => !l.hidden);
    const inside = (x) => x !== null && x >= low && x <= high;
    const seen = shown.flatMap((l) => l.y.filter((_, k) => inside(l.x[k])));
    const [bottom, top] = ends([...seen, this.floor, -this.floor], 0.05);
    const X = (x) => MARGIN.left + ((x - low) / (high - low)) * (width - MARGIN.left - MARGIN.right);
    const Y = (y) => height - MARGIN.bottom - ((y - bottom) / (top - bottom)) * (height - MARGIN.top - MARGIN.bottom);
    this.host.replaceChildren();
    const svg = make("svg", { viewBox: `0 0 ${width} ${height}`, role: "img",
      "aria-label": this.axes.join(" over ") }, this.host);
    const [left, right, floor, roof] = [X(low), X(high), Y(bottom), Y(top)];
    if (this.floor) {
      make("rect", { class: "floor", x: left, width: right - left, y: Y(this.floor),
        height: Y(-this.floor) - Y(this.floor) }, svg);
    }
    for (const y of ticks(bottom, top, height / 45)) {
      make("line", { class: y === 0 ? "zero" : "grid", x1: left, x2: right, y1: Y(y), y2: Y(y) }, svg);
      make("text", { x: left - 6, y: Y(y) + 4, "text-anchor": "end" }, svg, written(y));
    }
    for (const x of ticks(low, high, width / 65)) {
      make("text", { x: X(x), y: floor + 15, "text-anchor": "middle" }, svg, written(x));
    }
    for (const mark of this.marks.filter((m) => inside(m.x))) {
      make("line", { class: "mark", x1: X(mark.x), x2: X(mark.x), y1: roof, y2: floor }, svg);
      make("text", { x: X(mark.x) + 4, y: roof + 10 }, svg, mark.name);
    }
    for (const layer of shown) this.path(svg, layer, inside, X, Y);
    const [ordinate, abscissa] = this.axes;
    make("text", { x: right, y: height - 4, "text-anchor": "end" }, svg, abscissa);
    make("text", { x: 11, y: (roof + floor) / 2, "text-anchor": "middle",
      transform: `rotate(-90 11 ${(roof + floor) / 2})` }, svg, ordinate);
  }

  path(svg, { x, y, ink, dots }, inside, X, Y) {
    let d = "", pen = false;
    for (let k = 0; k < x.length; k++) {
      if (!inside(x[k])) { pen = false; continue; }
      d += `${pen ? "L" : "M"}${X(x[k]).toFixed(1)} ${Y(y[k]).toFixed(1)}`;
      if (dots) d += "h0";
      pen = !dots;
    }
    make("path", { d, stroke: ink, "stroke-width": dots || 1.1 }, svg);
  }
}

const plots = joints.map(() => []);

/** Names of layers that can be switched off; each key stands for a layer per plot. */
function keys(parent, names, of) {
  const line = make("div", { class: "keys" }, parent);
  names.forEach(([name, ink, off], k) => {
    const button = make("button", { class: "key", "aria-pressed": !off }, line);
    make("i", { style: `background:${ink}` }, button);
    button.append(name);
    button.onclick = () => {
      const hidden = button.getAttribute("aria-pressed") === "true";
      button.setAttribute("aria-pressed", !hidden);
      for (const plot of of()) { plot.layers[k].hidden = hidden; plot.draw(); }
    };
  });
}

function build(k) {
  const joint = joints[k], host = all(".joint")[k];
  make("h3", {}, host, `${joint.name}: gap over time`);
  const named = Object.keys(joint.time).map((name) => CURVES[name]);
  if (!("after" in joint.time)) named[1] = [CURVES.corrected[0], CURVES.after[1]];
  const layers = Object.values(joint.time).map(
    (curve, i) => ({ ...curve, ink: named[i][1], hidden: named[i].length > 2 }));
  const add = (parent, options) => plots[k].push(new Plot(parent, options)) && plots[k].at(-1);
  let time;
  keys(host, named, () => [time]);
  time = add(host, { layers, axes: [`gap [${joint.unit}]`, "time, recording after recording [s]"],
    height: 280, floor: joint.noise, marks: joint.marks });
  for (const { effect, y, law, order } of joint.clouds) {
    const names = effect
      ? [[`what is left without ${words(effect)}`, GREY], ["fitted law", inks[effect]]]
      : [["what is left", GREY]];
    make("h3", {}, host, effect ? `${joint.name}: ${words(effect)}` : `${joint.name}: what is left`);
    const own = [];
    keys(host, names, () => own);
    const grid = make("div", { class: "plots" }, host);
    for (const name of order) {  // first what the law is most clearly a function of
      const { x, unit } = joint.over[name];
      const clouds = [y, law].slice(0, names.length);
      own.push(add(grid, { height: 210, axes: [`gap [${joint.unit}]`, `${name} [${unit}]`],
        layers: clouds.map((values, i) => ({ x, y: values, ink: names[i][1], dots: 3.4 - 1.4 * i })) }));
    }
  }
}

function offerWhole() {
  document.getElementById("whole").hidden = !plots.flat().some((plot) => plot.zoomed);
}

function show(k) {
  all(".joint").forEach((host, i) => { host.hidden = i !== k; });
  all("#joint [data-pick]").forEach((button, i) => button.setAttribute("aria-pressed", i === k));
  if (!plots[k].length) build(k);
  plots[k].forEach((plot) => plot.draw());
}

let current = first;
all("[data-pick]").forEach((button) => button.addEventListener("click", () => {
  show(current = +button.dataset.pick);
  if (button.classList.contains("name")) document.getElementById("joint").scrollIntoView();
}));
all("[data-layer]").forEach((button) => button.addEventListener("click", () => {
  document.body.classList.toggle("show-beside", button.dataset.layer === "beside");
  all("[data-layer]").forEach((other) => other.setAttribute("aria-pressed", other === button));
}));
document.getElementById("whole").onclick = () => plots.flat().forEach((plot) => plot.zoom(...plot.whole));
addEventListener("resize", () => plots[current].forEach((plot) => plot.draw()));
addEventListener("beforeprint", () => joints.forEach((_, k) => {
  all(".joint")[k].hidden = false;  // what is hidden has no width to draw in
  if (!plots[k].length) build(k);
  plots[k].forEach((plot) => plot.draw());
}));
addEventListener("afterprint", () => show(current));
show(current);
