"use strict";
// Filter and sort the stimuli, play them by ear, switch between two at the same position.
(() => {
  const find = (id) => document.getElementById(id);
  const form = find("filter"), player = find("player");
  const sections = [...document.querySelectorAll("section.recording")].map((section) => {
    const body = section.querySelector(".stimuli tbody");
    return { section, body, name: section.querySelector("h2").textContent, rows: [...body.rows] };
  });
  const main = find("main"), total = sections.reduce((sum, one) => sum + one.rows.length, 0);

  // Filter and sort.
  const numberOf = (row, column) => {
    const value = Number.parseFloat(row.querySelectorAll("data")[column].value);
    return Number.isNaN(value) ? Infinity : value;
  };
  function isWanted(row, name) {
    const of = (key) => (form.elements[key] ? form.elements[key].value : "");
    const flag = of("flag"), flags = row.dataset.flags;
    return (!of("recording") || of("recording") === name) && (!of("reducer") || of("reducer") === row.dataset.reducer) &&
      (!of("level") || of("level") === row.dataset.level) && (!flag || (flag === "any" ? flags : flags.split(" ").includes(flag)));
  }
  function arrange() {
    const column = form.elements.sort.value, by = (row) => numberOf(row, Number(column));
    let shown = 0;
    const first = new Map();
    for (const one of sections) {
      const rows = column === "" ? one.rows : [...one.rows].sort((a, b) => (by(a) < by(b) ? -1 : by(a) > by(b) ? 1 : 0));
      const wanted = rows.filter((row) => { row.hidden = !isWanted(row, one.name); return !row.hidden; });
      one.body.append(...rows);
      one.section.hidden = !wanted.length;
      first.set(one, wanted.length && column !== "" ? by(wanted[0]) : 0);
      shown += wanted.length;
    }
    // Sorting is stable: without a column, recordings keep the set's order.
    for (const one of [...sections].sort((a, b) => (first.get(a) < first.get(b) ? -1 : first.get(a) > first.get(b) ? 1 : 0))) {
      main.insertBefore(one.section, player);
    }
    find("shown").textContent = `${shown} of ${total} shown`;
  }
  form.addEventListener("change", arrange);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("reset", () => setTimeout(arrange));

  // Two stimuli run side by side, one of them muted, so that a switch is heard at once and at the same position.
  const sides = { a: { audio: new Audio(), row: null }, b: { audio: new Audio(), row: null } };
  let heard = "a";
  const other = () => (heard === "a" ? "b" : "a");
  const nameOf = (row) => `${row.closest("section").querySelector("h2").textContent}, ${row.querySelector("th b").textContent}`;
  function load(side, row) {
    const one = sides[side], b = sides.b.row;
    if (side === "a" && b && b.parentNode !== row.parentNode) clear("b");
    if (one.row) one.row.classList.remove("playing");
    one.row = row;
    one.audio.src = row.querySelector("a").href;
    find(`pick-${side}`).querySelector("span").textContent = nameOf(row);
    player.hidden = false;
    for (const { row: marked } of Object.values(sides)) if (marked) marked.classList.add("playing");
    tune();
  }
  function clear(side) {
    const one = sides[side];
    one.row.classList.remove("playing");
    one.row = null;
    one.audio.removeAttribute("src");
    one.audio.load();
    find(`pick-${side}`).querySelector("span").textContent = "";
  }
  function tune() {
    const speed = Number(find("speed").value), volume = find("volume").value / 100;
    for (const [side, { audio }] of Object.entries(sides)) {
      audio.preservesPitch = false;
      audio.playbackRate = speed;
      audio.volume = volume;
      audio.loop = find("loop").checked;
      audio.muted = side !== heard;
      find(`pick-${side}`).setAttribute("aria-pressed", String(side === heard));
    }
    find("gain").textContent = volume ? `${Math.round(20 * Math.log10(volume))} dB` : "off";
  }
  const playing = () => !sides[heard].audio.paused;
  function align() {
    const [here, there] = [sides[heard].audio, sides[other()].audio];
    if (sides[other()].row && Math.abs(here.currentTime - there.currentTime) > 0.02) there.currentTime = here.currentTime;
  }
  function start() {
    const failed = (error) => { if (error.name !== "AbortError") find("shown").textContent = `cannot be played: ${error.message}`; };
    align();
    for (const { audio, row } of Object.values(sides)) if (row) audio.play().catch(failed);
  }
  function stop() {
    for (const { audio } of Object.values(sides)) audio.pause();
  }
  function choose(side) {
    if (!sides[side].row || side === heard) return;
    align();
    heard = side;
    tune();
  }
  // What is played is compared with its recording's reference, until another B is chosen; a B of another recording goes.
  function playRow(row) {
    const rows = sections.find((one) => one.body === row.parentNode).rows;
    const reference = rows.find((one) => one.dataset.role === "reference" && one.dataset.level === row.dataset.level);
    stop();
    load("a", row);
    if (reference && reference !== row) load("b", reference);
    heard = "a";
    tune();
    start();
  }
  const ACTIONS = {
    play: playRow,
    a: (row) => { stop(); load("a", row); heard = "a"; tune(); },
    b: (row) => { stop(); load("b", row); if (!sides.a.row) heard = "b"; tune(); },
  };
  for (const { rows } of sections) {
    for (const row of rows) {
      const link = row.querySelector("a"), name = row.querySelector("th b").textContent;
      for (const [action, text] of [["play", "Play"], ["a", "A"], ["b", "B"]]) {
        const button = document.createElement("button");
        Object.assign(button, { type: "button", textContent: text });
        button.dataset.action = action;
        button.setAttribute("aria-label", action === "play" ? `Play ${name}` : `${text}: ${name}`);
        link.before(button);
      }
    }
  }
  main.addEventListener("click", (event) => {
    const button = event.target.closest("button[data-action]");
    if (button) ACTIONS[button.dataset.action](button.closest("tr"));
  });
  find("play").addEventListener("click", () => (playing() ? stop() : start()));
  for (const side of ["a", "b"]) find(`pick-${side}`).addEventListener("click", () => choose(side));
  for (const id of ["volume", "speed", "loop"]) find(id).addEventListener("input", tune);
  find("position").addEventListener("input", (event) => {
    const { audio } = sides[heard];
    if (audio.duration) audio.currentTime = (event.target.value / 1000) * audio.duration;
    align();
  });
  for (const [side, { audio }] of Object.entries(sides)) {
    audio.addEventListener("timeupdate", () => {
      if (side === heard && audio.duration) find("position").value = String(Math.round((1000 * audio.currentTime) / audio.duration));
    });
    for (const name of ["play", "pause", "ended"]) {
      audio.addEventListener(name, () => { if (side === heard) find("play").textContent = playing() ? "Pause" : "Play"; });
    }
  }
  // Space on a button that has loaded its row plays and pauses; on others, and on links and fields, it does what it always does.
  const isLoaded = (button) => {
    const { action } = button.dataset;
    return Boolean(action) && sides[action === "b" ? "b" : "a"].row === button.closest("tr");
  };
  let taken = false;
  document.addEventListener("keydown", (event) => {
    taken = false;
    if (!find("keys").checked || player.hidden || event.ctrlKey || event.altKey || event.metaKey) return;
    const control = event.target.closest("input, select, textarea, button, a, summary");
    if (control && event.key === " " && !isLoaded(control)) return;
    if (event.target.closest("select, textarea")) return;
    if (event.key === " ") {
      taken = true;
      event.preventDefault();
      if (!event.repeat) find("play").click();
    } else if (event.key.toLowerCase() === "x") choose(other());
  });
  // Some browsers press a focused button when Space is released.
  document.addEventListener("keyup", (event) => { if (taken && event.key === " ") event.preventDefault(); });

  form.hidden = false;
  arrange();
})();
