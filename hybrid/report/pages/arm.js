"use strict";
// The arm, turned by mouse or keys; the wider a joint's gap, the larger its circle.

function drawArm(svg, { joints, ends, radius }, gaps, pick) {
  const points = [...joints, ...ends.flat()];
  const extreme = (pickEnd) => [0, 1, 2].map((k) => pickEnd(...points.map((p) => p[k])));
  const low = extreme(Math.min), high = extreme(Math.max);
  const middle = low.map((x, k) => (x + high[k]) / 2);
  const reach = Math.max(1e-3, ...radius) + Math.max(
    ...points.map((p) => Math.hypot(...p.map((x, k) => x - middle[k]))));
  const scale = 160 / reach;  // a sphere around the arm fills the picture
  const links = ends.length ? ends.map(([a, b], k) => [a, b, radius[k]])
    : joints.slice(1).map((b, k) => [joints[k], b, 0.05 * reach]);
  const [base, tip] = [joints[0], joints.at(-1)];
  const view = { turn: 0.3 - Math.atan2(tip[1] - base[1], tip[0] - base[0]), lift: 0.35 };  // reaches right

  /** From metres to right, down and away, in picture units. */
  function seen(point) {
    const [x, y, z] = point.map((value, k) => scale * (value - middle[k]));
    const [c, s] = [Math.cos(view.turn), Math.sin(view.turn)];
    const [up, over] = [Math.cos(view.lift), Math.sin(view.lift)];
    const away = s * x + c * y;
    return [c * x - s * y, -(up * z + over * away), up * away - over * z];
  }

  function add(tag, attributes, parent = svg) {
    const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
    return parent.appendChild(node);
  }

  function path(points, attributes) {
    add("path", { d: "M" + points.map((p) => `${p[0].toFixed(1)} ${p[1].toFixed(1)}`).join("L"),
      ...attributes });
  }

  function floor() {
    const ring = (part) => Array.from({ length: 49 }, (_, k) => {
      const angle = k * Math.PI / 24, far = part * 0.45 * reach;
      return seen([far * Math.cos(angle), far * Math.sin(angle), 0]);
    });
    for (const part of [0.5, 1]) path(ring(part), { class: "ring" });
  }

  function circles() {
    const places = [];
    joints.slice(1).map(seen).forEach(([x, y], k) => {
      const size = 11 + 8 * gaps[k];
      const close = () => places.find((p) => Math.hypot(p.x - x, p.y - y) < 0.8 * (p.size + size));
      for (let other = close(); other; other = close()) x = other.x + 0.81 * (other.size + size);
      places.push({ x, y, size });
    });
    places.forEach(({ x, y, size }, k) => {
      const group = add("g", { class: "axis", transform: `translate(${x.toFixed(1)} ${y.toFixed(1)})` });
      add("circle", { r: size, style: `--shade:${Math.round(100 * gaps[k])}%` }, group);
      add("text", { y: 5 }, group).textContent = k + 1;
      group.onclick = () => pick(k);
    });
  }

  function draw() {
    svg.replaceChildren();
    floor();
    const placed = links.map(([a, b, r]) => [seen(a), seen(b), 2 * r * scale]);
    placed.sort(([a, b], [c, d]) => c[2] + d[2] - a[2] - b[2]);  // the far ones first
    for (const [a, b, width] of placed) {
      path([a, b], { class: "edge", "stroke-width": width + 2 });
      path([a, b], { class: "link", "stroke-width": width });
    }
    circles();
  }

  function turn(across, down) {
    view.turn += across;
    view.lift = Math.min(1.5, Math.max(-1.5, view.lift + down));
    draw();
  }

  svg.addEventListener("pointermove", (event) => {
    if (event.buttons) turn(event.movementX / 120, event.movementY / 120);
  });
  svg.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0],
      ArrowUp: [0, -0.15], ArrowDown: [0, 0.15] }[event.key];
    if (!step) return;
    event.preventDefault();
    turn(...step);
  });
  draw();
}
