"use strict";
// The chart that a reader explores: choose axes, reducers, scenes; hover over or tab to a point for all its figures.
// Reads the JSON in #chart-data and draws SVG; needs no network and no library.
(() => {
  const data = JSON.parse(document.getElementById("chart-data").textContent);
  const svg = document.getElementById("explorer");
  const tip = document.getElementById("tip");
  const field = (id) => document.getElementById(id);
  const WIDTH = 900, HEIGHT = 540, LEFT = 70, RIGHT = 20, TOP = 15, BOTTOM = 55, SLOT = 70;
  const NS = "http://www.w3.org/2000/svg";

  const SHAPES = {
    o: () => Array.from({ length: 24 }, (_, k) => turn(1, k / 24)),
    s: () => [[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]],
    D: () => [0, 1, 2, 3].map((k) => turn(1.15, k / 4)),
    "^": () => [0, 1, 2].map((k) => turn(1.2, k / 3)),
    v: () => [0, 1, 2].map((k) => turn(1.2, k / 3 + 0.5)),
    "<": () => [0, 1, 2].map((k) => turn(1.2, k / 3 + 0.75)),
    ">": () => [0, 1, 2].map((k) => turn(1.2, k / 3 + 0.25)),
    p: () => [0, 1, 2, 3, 4].map((k) => turn(1.1, k / 5)),
    "*": () => Array.from({ length: 10 }, (_, k) => turn(k % 2 ? 0.5 : 1.3, k / 10)),
    P: () => cross(0),
    X: () => cross(1 / 8),
  };
  function turn(radius, share) {
    return [radius * Math.sin(2 * Math.PI * share), -radius * Math.cos(2 * Math.PI * share)];
  }
  function cross(share) {
    const corners = [[-0.4, -1], [0.4, -1], [0.4, -0.4], [1, -0.4], [1, 0.4], [0.4, 0.4],
      [0.4, 1], [-0.4, 1], [-0.4, 0.4], [-1, 0.4], [-1, -0.4], [-0.4, -0.4]];
    const [s, c] = [Math.sin(2 * Math.PI * share), Math.cos(2 * Math.PI * share)];
    return corners.map(([x, y]) => [c * x - s * y, s * x + c * y]);
  }
  function shape(marker, x, y, size) {
    return SHAPES[marker]().map(([a, b]) => `${(x + size * a).toFixed(1)},${(y + size * b).toFixed(1)}`).join(" ");
  }

  function add(parent, name, attributes, text) {
    const element = document.createElementNS(NS, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (text !== undefined) element.textContent = text;
    parent.appendChild(element);
    return element;
  }
  function tell(value) {
    if (value === null || value === undefined) return "–";
    if (value === 0) return "0";
    return Math.abs(value) >= 100 ? Math.round(value).toLocaleString("en") : String(Number(value.toPrecision(3)));
  }
  // Black is the page's ink, which is light on dark paper.
  const paint = (colour) => (colour === "#000000" ? "currentColor" : colour);
  const checked = (name) => new Set([...document.querySelectorAll(`input[name="${name}"]:checked`)].map((box) => box.value));
  const axisOf = (id) => data.axes.find((axis) => axis.key === field(id).value);

  function median(values) {
    const sorted = [...values].sort((a, b) => a - b), half = (sorted.length - 1) / 2;
    return (sorted[Math.floor(half)] + sorted[Math.ceil(half)]) / 2;
  }

  // What a method has on an axis: its value, the span that is drawn beside it, and its scenes.
  function valueOf(method, axis, scenes) {
    if (axis.kind === "speed") {
      const [value, low, high] = method.speed[axis.key];
      return { value, low, high, scenes: null };
    }
    if (axis.kind === "rating") {
      const rating = method.ratings[axis.key];
      return rating ? { value: rating[0], low: rating[3], high: rating[4], scenes: null } : undefined;
    }
    // Not everything was measured of every method: the stability of other windows was not.
    const own = scenes.map((scene) => method.scores[scene][axis.key]).filter(Boolean).map((one) => one[0]);
    if (!own.length) return undefined;
    return { value: median(own), low: Math.min(...own), high: Math.max(...own), scenes: own };
  }

  // Log axes have a place of their own for what has no logarithm (left) and for what has no end (right).
  function makeScale(axis, found, from, to, log) {
    const numbers = found.flatMap((one) => [one.value, one.low, one.high])
      .filter((one) => one !== null && one !== undefined && (!log || one > 0));
    const none = log && found.some((one) => one.value === 0);
    const endless = found.some((one) => one.value === null);
    const sign = Math.sign(to - from);
    const begin = from + (none ? sign * SLOT : 0), end = to - (endless ? sign * SLOT : 0);
    let low = Math.min(...numbers), high = Math.max(...numbers);
    if (!numbers.length) [low, high] = [1, 10];
    if (axis.kind === "accuracy" && !log) [low, high] = [Math.max(Math.min(low, 0), -1), 1];
    if (axis.kind === "rating") [low, high] = [0, 100];
    if (log) [low, high] = [low / 1.15, high * 1.15];
    else if (axis.kind === "speed") [low, high] = [0, high * 1.05];
    else [low, high] = [low - 0.03 * (high - low), high + 0.03 * (high - low)];
    const f = log ? Math.log10 : (one) => one;
    const place = (one) => {
      if (one === null || one === undefined) return to - sign * SLOT / 2;
      if (log && one <= 0) return from + sign * SLOT / 2;
      const inside = Math.min(Math.max(one, low), high);
      return begin + (end - begin) * (f(inside) - f(low)) / (f(high) - f(low) || 1);
    };
    return { place, ticks: log ? logTicks(low, high) : linearTicks(low, high), none, endless, low };
  }
  function logTicks(low, high) {
    const parts = Math.log10(high / low) > 3 ? [1] : [1, 2, 5];
    const ticks = [];
    for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power += 1) {
      ticks.push(...parts.map((part) => part * 10 ** power));
    }
    return ticks.filter((tick) => tick >= low && tick <= high);
  }
  function linearTicks(low, high) {
    const rough = (high - low) / 6, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((part) => part * power).find((part) => part >= rough);
    const ticks = [];
    for (let tick = Math.ceil(low / step) * step; tick <= high; tick += step) ticks.push(Number(tick.toPrecision(10)));
    return ticks;
  }

  function drawAxes(x, y, xAxis, yAxis) {
    const bottom = HEIGHT - BOTTOM, right = WIDTH - RIGHT;
    add(svg, "path", { d: `M${LEFT},${TOP}V${bottom}H${right}`, class: "frame" });
    for (const tick of x.ticks) {
      add(svg, "path", { d: `M${x.place(tick)},${TOP}V${bottom}`, class: "grid" });
      add(svg, "text", { x: x.place(tick), y: bottom + 18, "text-anchor": "middle" }, tell(tick));
    }
    for (const tick of y.ticks) {
      add(svg, "path", { d: `M${LEFT},${y.place(tick)}H${right}`, class: "grid" });
      add(svg, "text", { x: LEFT - 8, y: y.place(tick) + 4, "text-anchor": "end" }, tell(tick));
    }
    if (x.none) add(svg, "text", { x: x.place(0), y: bottom + 18, "text-anchor": "middle" }, "none");
    if (x.endless) add(svg, "text", { x: x.place(null), y: bottom + 18, "text-anchor": "middle" }, "whole signal");
    if (y.none) add(svg, "text", { x: LEFT - 8, y: y.place(0) + 4, "text-anchor": "end" }, "none");
    if (y.endless) add(svg, "text", { x: LEFT - 8, y: y.place(null) + 4, "text-anchor": "end" }, "whole");
    add(svg, "text", { x: (LEFT + right) / 2, y: HEIGHT - 12, "text-anchor": "middle", class: "name" }, xAxis.label);
    const middle = (TOP + bottom) / 2;
    add(svg, "text", { x: 18, y: middle, "text-anchor": "middle", transform: `rotate(-90 18 ${middle})`, class: "name" },
      yAxis.label);
  }

  function worth(axis, value) {
    const number = value === null ? Infinity : value;
    return axis.better === "low" ? number : -number;
  }
  function findFront(points, xAxis, yAxis) {
    const pairs = points.map((point) => [worth(xAxis, point.x.value), worth(yAxis, point.y.value)]);
    return points.filter((_, i) => !pairs.some(([a, b]) =>
      a <= pairs[i][0] && b <= pairs[i][1] && (a < pairs[i][0] || b < pairs[i][1])));
  }

  function draw() {
    const xAxis = axisOf("x-axis"), yAxis = axisOf("y-axis");
    const reducers = checked("reducer"), sweeps = checked("sweep");
    const scenes = data.scenes.filter((scene) => checked("scene").has(scene));
    const points = data.methods
      // Methods that are equal by construction are one point; as mounted, people rated each of them.
      .filter((method) => !method.member || xAxis.kind === "rating" || yAxis.kind === "rating")
      .filter((method) => reducers.has(method.reducer) && (method.kind === "reducer" || sweeps.has(method.kind)))
      .map((method) => ({ method, x: valueOf(method, xAxis, scenes), y: valueOf(method, yAxis, scenes) }))
      .filter((point) => point.x && point.y);
    svg.replaceChildren();
    tip.hidden = true;
    const x = makeScale(xAxis, points.map((point) => point.x), LEFT, WIDTH - RIGHT, xAxis.log && field("log").checked);
    const y = makeScale(yAxis, points.map((point) => point.y), HEIGHT - BOTTOM, TOP, yAxis.log && field("log").checked);
    drawAxes(x, y, xAxis, yAxis);
    const front = findFront(points, xAxis, yAxis).sort((a, b) => worth(xAxis, a.x.value) - worth(xAxis, b.x.value));
    if (front.length) {
      const steps = front.map((point, k) => {
        const [px, py] = [x.place(point.x.value), y.place(point.y.value)];
        return k ? `H${px}V${py}` : `M${px},${py}`;
      });
      add(svg, "path", { d: steps.join(""), class: "front" });
    }
    for (const point of points) drawPoint(point, { x, y, scenes, xAxis, yAxis, onFront: front.includes(point) });
    const dominated = points.filter((point) => !front.includes(point)).map((point) => point.method.label);
    field("front").textContent = points.length
      ? `On the front, by the values as drawn: ${front.map((point) => point.method.label).join("; ")}. ` +
        (dominated.length ? `Off it: ${dominated.join("; ")}.` : "None is off it.")
      : "Nothing to show: choose at least one reducer and one scene.";
  }

  function drawPoint(point, view) {
    const { method } = point;
    const px = view.x.place(point.x.value), py = view.y.place(point.y.value);
    const spans = [
      [view.x.place(point.x.low), py, view.x.place(point.x.high), py],
      [px, view.y.place(point.y.low), px, view.y.place(point.y.high)],
    ];
    for (const [x1, y1, x2, y2] of spans) add(svg, "line", { x1, y1, x2, y2, stroke: paint(method.colour), class: "span" });
    if (field("dots").checked && (point.x.scenes || point.y.scenes)) {
      view.scenes.forEach((_, k) => add(svg, "circle", {
        cx: point.x.scenes ? view.x.place(point.x.scenes[k]) : px,
        cy: point.y.scenes ? view.y.place(point.y.scenes[k]) : py,
        r: 2.5, fill: paint(method.colour), class: "scene",
      }));
    }
    const size = method.kind === "reducer" ? 7 : 4.5;
    const mark = add(svg, "polygon", {
      points: shape(method.marker, px, py, size), fill: paint(method.colour), tabindex: "0", role: "img",
      class: view.onFront ? "point on-front" : "point", "aria-label": describe(point, view).join(", "),
    });
    const show = () => showTip(describe(point, view), px, py);
    for (const event of ["mouseenter", "focus"]) mark.addEventListener(event, show);
    for (const event of ["mouseleave", "blur"]) mark.addEventListener(event, () => { tip.hidden = true; });
  }

  function describe(point, view) {
    const { method } = point;
    const lines = [method.label + (view.onFront ? " (on the front)" : "")];
    for (const axis of data.axes) {
      const found = valueOf(method, axis, view.scenes);
      if (!found) continue;
      const value = found.value === null ? "whole signal" : tell(found.value);
      const span = found.low !== null && found.low !== undefined && found.low !== found.high
        ? ` [${tell(found.low)} to ${tell(found.high)}]` : "";
      lines.push(`${axis.label}: ${value}${span}`);
    }
    if (view.scenes.length === 1) {
      for (const axis of data.axes.filter((one) => one.kind === "accuracy")) {
        const [, sd, mounted] = method.scores[view.scenes[0]][axis.key];
        lines.push(`${axis.label}, over orientations: SD ${tell(sd)}; as mounted: ${tell(mounted)}`);
      }
    }
    return lines;
  }
  function showTip(lines, px, py) {
    tip.replaceChildren(...lines.map((line, k) => {
      const element = document.createElement(k ? "div" : "strong");
      element.textContent = line;
      return element;
    }));
    const box = svg.getBoundingClientRect(), scale = box.width / WIDTH;
    tip.hidden = false;
    tip.style.left = `${Math.max(0, Math.min(px * scale + 14, box.width - tip.offsetWidth))}px`;
    const above = py * scale - tip.offsetHeight - 12;
    tip.style.top = `${above > 0 ? above : py * scale + 14}px`;
  }

  for (const swatch of document.querySelectorAll("svg.swatch")) {
    add(swatch, "polygon", { points: shape(swatch.dataset.marker, 0, 0, 7), fill: paint(swatch.dataset.colour) });
  }
  for (const input of document.querySelectorAll("#controls input, #controls select")) input.addEventListener("change", draw);
  for (const button of document.querySelectorAll("#controls button")) {
    button.addEventListener("click", () => {
      const boxes = [...document.querySelectorAll(`input[name="${button.dataset.of}"]`)];
      const all = boxes.every((box) => box.checked);
      for (const box of boxes) box.checked = !all;
      draw();
    });
  }
  draw();
})();
