// Pictures of one joint at a time, by uPlot.

const { joints, inks, first, after, arm, gaps } = JSON.parse(document.getElementById("data").textContent);
const PRINTED = 640;  // pixels: the width of a printed page
const all = (selector, root = document) => [...root.querySelectorAll(selector)];
const words = (id) => id.replaceAll("_", " ");
const written = (_, x) => (x == null ? "" : String(+x.toPrecision(4)).replace("-", "−"));
/** A colour for a canvas, which knows no variables. */
const ink = (name) => name.startsWith("--")
  ? getComputedStyle(document.documentElement).getPropertyValue(name).trim() : name;

function make(tag, attributes, parent, text = "") {
  const node = Object.assign(document.createElement(tag), attributes);
  node.append(text);
  parent.append(node);
  return node;
}

const axis = (label, size) => ({
  label, size, labelSize: 16, labelGap: 0, gap: 4, font: "11px sans-serif", labelFont: "11px sans-serif",
  stroke: () => ink("--soft"), grid: { stroke: () => ink("--faint"), width: 1 },
  ticks: { show: false }, values: (u, values) => values.map((x) => written(u, x)),
});

/** Noise as a band, zero and the beginning of recordings as lines. */
function ground(u, noise, marks) {
  const { left, top, width, height } = u.bbox, pen = u.ctx;
  const at = (value, scale) => u.valToPos(value, scale, true);
  pen.save();
  pen.beginPath();
  pen.rect(left, 0, width, top + height);
  pen.clip();
  pen.fillStyle = ink("--faint");
  pen.fillRect(left, at(noise, "y"), width, at(-noise, "y") - at(noise, "y"));
  pen.fillStyle = ink("--line");
  pen.fillRect(left, at(0, "y"), width, devicePixelRatio);
  pen.font = `${11 * devicePixelRatio}px sans-serif`;
  for (const { x, name } of marks) {
    pen.fillStyle = ink("--line");
    pen.fillRect(at(x, "x"), 0, devicePixelRatio, top + height);
    pen.fillStyle = ink("--soft");
    pen.fillText(name, at(x, "x") + 4 * devicePixelRatio, 11 * devicePixelRatio);
  }
  pen.restore();
}

/** Curves [name, colour], or clouds where dots have a size, over one abscissa. */
function plot(parent, data, curves, axes, { height, dots, noise = 0, marks = [] }) {
  const host = make("div", { className: "plot", tabIndex: 0 }, parent);
  const range = (_, low, high) => {
    const room = high > low ? (dots ? 0.03 : 0) * (high - low) : 1;
    return [low - room, high + room];
  };
  const series = curves.map(([label, name], k) => ({
    label, value: written, stroke: () => ink(name), width: 1.2,
    ...(dots && { paths: () => null, points: { show: true, space: 0, width: 0, size: dots[k],
      fill: () => ink(name) } }),
  }));
  const fill = (_, k) => (curves[k - 1]?.[1] ?? "").replace(/^--.*/, "var($&)");
  const u = new uPlot({
    width: host.clientWidth || PRINTED, height, padding: [marks.length ? 20 : 8, 8, 0, 0],
    series: [{ label: axes[0].split(/[,[]/)[0], value: written }, ...series],
    scales: { x: { time: false, range } },
    axes: [axis(axes[0], 30), axis(axes[1], 46)], cursor: { y: false, points: { show: !dots } },
    legend: { markers: { width: 0, fill } },
    hooks: { drawClear: [() => ground(u, noise, marks)] },
  }, data, host);
  all(".u-series:not(:first-child) .u-label", host).forEach((name) => {
    Object.assign(name, { tabIndex: 0, role: "button", ariaPressed: true });
    name.onkeydown = (event) => { if (["Enter", " "].includes(event.key)) name.click(event.preventDefault()); };
    name.addEventListener("click", () => { name.ariaPressed = name.ariaPressed !== "true"; });
  });
  host.addEventListener("keydown", (event) => moved(u, event));
  return u;
}

/** Zoom or shift the abscissa by a key. */
function moved(u, event) {
  const whole = [u.data[0][0], u.data[0].at(-1)], { min, max } = u.scales.x, span = max - min;
  const move = { "+": [0.2, -0.2], "=": [0.2, -0.2], "-": [-0.3, 0.3], 0: [-Infinity, Infinity],
    ArrowLeft: [-0.2, -0.2], ArrowRight: [0.2, 0.2] }[event.key];
  if (!move) return;
  event.preventDefault();
  const [low, high] = [Math.max(whole[0], min + move[0] * span), Math.min(whole[1], max + move[1] * span)];
  u.setScale("x", { min: low, max: high });
}

const plots = joints.map(() => []);

function build(k) {
  const joint = joints[k], host = all(".joint")[k], gap = `gap [${joint.unit}]`;
  make("h3", {}, host, `${joint.name}: gap over time`);
  plots[k].push(plot(host, joint.time, [["simulator as it stands", "--gap"], [after, "--blue"]],
    ["time, recording after recording [s]", gap], { height: 260, ...joint }));
  for (const { effect, y, law, order } of joint.clouds) {
    make("h3", {}, host, `${joint.name}: ${effect ? words(effect) : "what is left"}`);
    const curves = effect
      ? [[`what is left without ${words(effect)}`, "--grey"], ["fitted law", inks[effect]]]
      : [["what is left", "--grey"]];
    const grid = make("div", { className: "plots" }, host);
    for (const name of order) {  // first what the law is most clearly a function of
      const { x, unit } = joint.over[name];
      const sorted = [...x.keys()].sort((a, b) => x[a] - x[b]);
      const data = [x, y, law].slice(0, 1 + curves.length).map((values) => sorted.map((i) => values[i]));
      plots[k].push(plot(grid, data, curves, [`${name} [${unit}]`, gap], { height: 200, dots: [4, 2.5] }));
    }
  }
}

function fit(k) {
  const printed = document.documentElement.classList.contains("printed");
  for (const u of plots[k]) {
    const narrow = u.root.matches(".plots .plot:not(:first-child) *");
    const width = printed ? PRINTED / (narrow ? 3.1 : 1) : u.root.parentNode.clientWidth;
    u.setSize({ width, height: u.height });
  }
}

let current = first;

function show(k) {
  current = k;
  all(".joint").forEach((host, i) => { host.hidden = i !== k; });
  all("#joint [data-pick]").forEach((button, i) => button.setAttribute("aria-pressed", i === k));
  if (!plots[k].length) build(k);
  fit(k);
}

function pick(k) {
  show(k);
  document.getElementById("joint").scrollIntoView();
}

/** For print, all joints and all that was folded; afterwards the one looked at. */
function spread(on) {
  const looked = current;
  document.documentElement.classList.toggle("printed", on);
  joints.forEach((_, k) => show(k));
  show(looked);
  if (on) all(".joint, details").forEach((part) => Object.assign(part, { hidden: false, open: true }));
}

all("[data-pick]").forEach((button) => button.addEventListener("click",
  () => (button.classList.contains("name") ? pick : show)(+button.dataset.pick)));
addEventListener("resize", () => fit(current));
addEventListener("beforeprint", () => spread(true));
addEventListener("afterprint", () => spread(false));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => plots.flat().forEach((u) => u.redraw()));
show(first);
drawArm(document.getElementById("arm"), arm, gaps, pick);
