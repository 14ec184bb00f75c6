"use strict";
// Adds to a report what only a script can: tables that are sorted and downloaded, points that say what they are, and
// r and slope without some reducers or recordings. Nothing on the page needs it.
(() => {
  const make = (name, attributes = {}, ...children) => {
    const element = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    element.append(...children);
    return element;
  };
  const plain = (text) => text.replace(/\u2212/g, "-").replace(/[\u00a0\u202f]/g, " ").trim();
  const number = (cell) => parseFloat(plain(cell).replace(/^[^\d-]*/, ""));

  // Tables.
  const cellsOf = (row) => [...row.cells].map((cell) => cell.textContent.trim());
  function compare(column, isText, sign) {
    return (one, other) => {
      const [a, b] = [one, other].map((row) => row.cells[column].textContent.trim());
      if (isText) return sign * plain(a).localeCompare(plain(b), "en", { numeric: true });
      const [x, y] = [number(a), number(b)];
      if (isNaN(x) || isNaN(y)) return isNaN(x) - isNaN(y);  // no number comes last, whichever way
      return sign * (x - y);
    };
  }
  function makeSortable(table) {
    const body = table.tBodies[0], rows = [...body.rows], heads = [...table.tHead.rows[0].cells];
    if (rows.length < 2) return;
    heads.forEach((head, column) => {
      const button = make("button", { type: "button", class: "sort" }, ...head.childNodes);
      head.replaceChildren(button);
      button.addEventListener("click", () => {
        const next = { ascending: "descending", descending: "" }[head.getAttribute("aria-sort")] ?? "ascending";
        for (const one of heads) one.removeAttribute("aria-sort");
        if (next) head.setAttribute("aria-sort", next);
        const isText = column === 0 || head.classList.contains("text");
        const sorted = next ? [...rows].sort(compare(column, isText, next === "ascending" ? 1 : -1)) : rows;
        body.append(...sorted);
      });
    });
  }
  function makeCsv(table) {
    const quote = (text) => (/[",\n]/.test(text) ? `"${text.replace(/"/g, '""')}"` : text);
    const rows = [...table.rows].map((row) => cellsOf(row).map(plain)), seen = new Map();
    let estimate = "";  // whose interval a column of that name holds
    rows[0] = rows[0].map((text) => {
      estimate = text === "Interval" ? estimate : text;
      const name = text === "Interval" ? `${estimate}, interval` : text;
      seen.set(name, (seen.get(name) || 0) + 1);
      return seen.get(name) > 1 ? `${name} (${seen.get(name)})` : name;
    });
    return rows.map((row) => row.map(quote).join(",")).join("\n") + "\n";
  }
  function addDownload(table, place) {
    const name = (table.caption?.textContent || `table ${place + 1}`).trim();
    const button = make("button", { type: "button", class: "small" }, "Download as CSV");
    button.setAttribute("aria-label", `Download as CSV: ${name}`);
    button.addEventListener("click", () => {
      const file = new Blob([makeCsv(table)], { type: "text/csv;charset=utf-8" });
      const link = make("a", { href: URL.createObjectURL(file), download: `table-${place + 1}.csv` });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    });
    (table.closest(".scroll") || table).after(button);
  }
  document.querySelectorAll("main table").forEach((table, place) => {
    if (!table.tHead || !table.tBodies.length) return;
    makeSortable(table);
    addDownload(table, place);
  });

  // A figure that is scrolled sideways can be reached by the keyboard.
  const reach = () => document.querySelectorAll("figure").forEach((figure) => {
    if (figure.scrollWidth > figure.clientWidth) figure.tabIndex = 0;
    else figure.removeAttribute("tabindex");
  });
  addEventListener("resize", reach);
  document.addEventListener("toggle", reach, true);
  reach();

  // Scatters.
  const holder = document.getElementById("points");
  if (!holder) return;
  const data = JSON.parse(holder.textContent);
  const [NAME, REDUCER, RECORDING, X, Y, LOW, HIGH, N] = [0, 1, 2, 3, 4, 5, 6, 7];
  const show = (value, digits) => (Number.isFinite(value) ? value.toFixed(digits).replace("-", "\u2212") : "–");

  // Pearson's r of each recording, averaged over Fisher's z, as the report does; the slope of least squares with an
  // intercept per recording.
  function correlate(points) {
    const own = [...new Set(points.map((one) => one[RECORDING]))].map((name) => {
      const part = points.filter((one) => one[RECORDING] === name), n = part.length;
      const centre = [X, Y].map((place) => part.reduce((sum, one) => sum + one[place], 0) / n);
      const r = relate(part, () => centre, (xx, xy, yy) => xy / Math.sqrt(xx * yy));
      return Math.abs(r) < 1 - 1e-9 ? r : Math.sign(r) * (1 - 6 / (n * (n * n - 1)));
    }).filter(Number.isFinite);
    return Math.tanh(own.reduce((sum, r) => sum + Math.atanh(r), 0) / own.length);
  }
  function fitSlope(points) {
    const sums = new Map();
    for (const one of points) {
      const own = sums.get(one[RECORDING]) || [0, 0, 0];
      sums.set(one[RECORDING], [own[0] + one[X], own[1] + one[Y], own[2] + 1]);
    }
    const centre = (one) => { const [x, y, n] = sums.get(one[RECORDING]); return [x / n, y / n]; };
    return relate(points, centre, (xx, xy) => xy / xx);
  }
  function relate(points, centre, combine) {
    let [xx, xy, yy] = [0, 0, 0];
    for (const one of points) {
      const [mx, my] = centre(one);
      const [dx, dy] = [one[X] - mx, one[Y] - my];
      [xx, xy, yy] = [xx + dx * dx, xy + dx * dy, yy + dy * dy];
    }
    // What is left of equal values is rounding.
    const scale = Math.max(...points.map((one) => Math.abs(one[X])), 0) ** 2 * points.length;
    return points.length > 2 && xx > 1e-18 * scale ? combine(xx, xy, yy) : NaN;
  }

  const out = { reducers: new Set(), recordings: new Set() };
  const isOut = (point) => out.reducers.has(point[REDUCER]) || out.recordings.has(point[RECORDING]);
  const marks = data.panels.flatMap((panel) => Object.entries(panel.marks).flatMap(([name, places]) =>
    [...document.querySelectorAll(`figure [id$="-${name}"]`)].flatMap((group) =>
      [...group.querySelectorAll("use")].map((element, k) => ({ element, panel, point: panel.points[places[k]] })))));

  // A point says what it is.
  const tip = make("div", { class: "tip", "aria-hidden": "true" });
  tip.hidden = true;
  document.body.append(tip);
  function describe({ panel, point }) {
    const interval = point[LOW] === null ? "" : ` (${show(point[LOW], 1)} to ${show(point[HIGH], 1)})`;
    return [
      point[NAME], `${data.reducers[point[REDUCER]]}, ${data.recordings[point[RECORDING]]}`,
      `${panel.ratings}: ${show(point[Y], 1)}${interval}, ${point[N]} participant${point[N] === 1 ? "" : "s"}`,
      `${panel.metric}: ${show(point[X], 3)}`,
    ];
  }
  function showTip(mark) {
    tip.replaceChildren(...describe(mark).map((line, k) => make(k ? "div" : "strong", {}, line)));
    tip.hidden = false;
    const box = mark.element.getBoundingClientRect();
    const left = Math.min(box.right + 10, document.documentElement.clientWidth - tip.offsetWidth - 4);
    tip.style.left = `${Math.max(4, left) + scrollX}px`;
    tip.style.top = `${Math.max(4, box.top - tip.offsetHeight - 6) + scrollY}px`;
  }
  const hideTip = () => { tip.hidden = true; };
  addEventListener("keydown", (event) => { if (event.key === "Escape") hideTip(); });

  // One stop of the tab key per panel; arrows go from point to point, along the metric.
  const panels = new Map();
  for (const mark of marks) {
    const svg = mark.element.closest("svg"), key = mark.panel;
    svg.setAttribute("role", "group");
    if (!panels.has(svg)) panels.set(svg, new Map());
    if (!panels.get(svg).has(key)) panels.get(svg).set(key, []);
    panels.get(svg).get(key).push(mark);
  }
  for (const own of [...panels.values()].flatMap((of) => [...of.values()])) {
    own.sort((one, other) => one.point[X] - other.point[X]);
    own.forEach((mark, place) => {
      const { element } = mark;
      for (const [key, value] of Object.entries({
        role: "img", class: "mark", tabindex: place ? "-1" : "0", "aria-label": describe(mark).join("; "),
      })) element.setAttribute(key, value);
      for (const event of ["mouseenter", "focus"]) element.addEventListener(event, () => showTip(mark));
      for (const event of ["mouseleave", "blur"]) element.addEventListener(event, hideTip);
      element.addEventListener("keydown", (event) => {
        const by = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
        const next = by && own[place + by];
        if (!next) return;
        event.preventDefault();
        element.setAttribute("tabindex", "-1");
        next.element.setAttribute("tabindex", "0");
        next.element.focus();
      });
    });
  }

  // Reducers and recordings to leave out, and what becomes of r and slope.
  const pers = new Set(data.panels.map((panel) => panel.per));
  const per = pers.size === 1 ? [...pers][0] : "step";
  const rows = data.panels.map((panel) => {
    const full = [panel.r, fitSlope(panel.points) * panel.step];
    const cells = [make("td", { class: "now" }), make("td", { class: "now" }), make("td")];
    const name = pers.size === 1 ? panel.metric : `${panel.metric}, per ${panel.per}`;
    const row = make("tr", {}, make("th", { scope: "row" }, panel.ratings), make("td", { class: "text" }, name),
      make("td", {}, show(full[0], 2)), cells[0], make("td", {}, show(full[1], 2)), cells[1], cells[2]);
    return { panel, row, cells };
  });
  const status = make("p", { role: "status", class: "faint" });
  function update() {
    for (const { element, point } of marks) element.classList.toggle("out", isOut(point));
    for (const { panel, cells } of rows) {
      const left = panel.points.filter((point) => !isOut(point));
      const values = [show(correlate(left), 2), show(fitSlope(left) * panel.step, 2), String(left.length)];
      cells.forEach((cell, k) => { cell.textContent = values[k]; });
    }
    const gone = [...[...out.reducers].map((k) => data.reducers[k]), ...[...out.recordings].map((k) => data.recordings[k])];
    status.textContent = gone.length ? `Without ${gone.join(", ")}.` : "Nothing is left out.";
  }
  function makeChoice(title, kind) {
    const boxes = data[kind].map((name, k) => {
      const box = make("input", { type: "checkbox", name: kind, value: String(k) });
      box.checked = true;
      box.addEventListener("change", () => { out[kind][box.checked ? "delete" : "add"](k); update(); });
      return make("label", {}, box, ` ${name}`);
    });
    return make("fieldset", {}, make("legend", {}, title), ...boxes);
  }
  const heads = ["Ratings", "Metric", "r", "r, chosen", `Slope per ${per}`, "Slope, chosen", "Stimuli"];
  const texts = new Set([0, 1]);
  const table = make("table", {},
    make("caption", {}, make("span", {}, "All stimuli, and those chosen. r: Pearson within recordings, over the stimuli’s mean ratings. Slope: " +
      "plain least squares within recordings, in points of rating; the primary model weighs participants too.")),
    make("thead", {}, make("tr", {}, ...heads.map((name, k) =>
      make("th", { scope: "col", ...(texts.has(k) ? { class: "text" } : {}) }, name)))),
    make("tbody", {}, ...rows.map(({ row }) => row)));
  const region = make("div", { class: "scroll", role: "region", tabindex: "0", "aria-label": "r and slope of the chosen stimuli" }, table);
  const panel = make("details", { class: "explore" }, make("summary", {}, "Leave out reducers or recordings"),
    makeChoice("Reducers", "reducers"), makeChoice("Recordings", "recordings"), status, region);
  const last = marks.length ? marks[marks.length - 1].element.closest("figure") : null;
  makeSortable(table);
  addDownload(table, document.querySelectorAll("main table").length);
  if (last) last.before(panel);
  update();
})();
