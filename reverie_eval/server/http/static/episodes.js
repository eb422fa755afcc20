// Replays an episode's trajectories on its map, selects a level, and navigates with the arrow keys.
const figure = document.getElementById("walked");
const map = figure?.querySelector("svg.walkable");
const SVG = "http://www.w3.org/2000/svg";
const SECONDS_A_STEP = 0.8;
const VIEW_SIZE = [400, 457]; // of a view with its panorama, as the server draws it

function element(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent.append(made);
  return made;
}

// Levels.

function chooseLevel(level) {
  for (const part of map.querySelectorAll("[data-levels]")) {
    const isOn = part.dataset.levels.split(" ").includes(level);
    const isFaint = level === "" ? "elsewhere" in part.dataset : level !== "all" && !isOn;
    if (isFaint) part.setAttribute("opacity", level === "" ? "0.35" : "0.15");
    else part.removeAttribute("opacity");
  }
}

// Steps.

class Walk {
  constructor(number, start) {
    this.number = number;
    this.legs = [...map.querySelectorAll(`.leg[data-route="${number}"]`)];
    this.places = [start, ...this.legs.map((leg) => {
      const way = leg.querySelector(".route");
      return way.getPointAtLength(way.getTotalLength());
    })];
    this.rows = [...document.querySelectorAll(`.steps[data-route="${number}"] [data-step]`)];
    this.answer = document.querySelector(`.answers [data-route="${number}"]`);
    this.walker = element("circle", { class: `walker route-${number}`, r: 6.5, cx: 0, cy: 0 }, map);
    this.goTo(this.legs.length);
    this.walker.classList.add("resting");
  }

  goTo(step) {
    const own = Math.min(step, this.legs.length);
    const { x, y } = this.places[own];
    this.walker.style.transform = `translate(${x}px, ${y}px)`;
    this.walker.classList.remove("resting");
    this.legs.forEach((leg, index) => leg.classList.toggle("ahead", index >= own));
    this.rows.forEach((row) => {
      if (Number(row.dataset.step) === own) row.setAttribute("aria-current", "step");
      else row.removeAttribute("aria-current");
    });
    this.look(own);
  }

  // Shows what the agent saw at a step in the place of its answer, which it gave at the last one.
  look(step) {
    const row = this.rows[step];
    const facing = row?.dataset.facing;
    const isOnWay = step < this.legs.length && facing !== undefined;
    if (!this.answer) return;
    this.answer.classList.toggle("on-the-way", isOnWay);
    this.answer.querySelector(".moment").textContent = isOnWay ? `Step ${step}, facing ${facing}°` : "Answer";
    if (!isOnWay) return;
    if (!this.view) {
      this.view = new Image(...VIEW_SIZE);
      this.answer.querySelector("h2").after(this.view);
    }
    this.view.alt = this.answer.querySelector("h2").textContent.trim();
    const viewpoint = row.querySelector(".viewpoint-id").textContent;
    this.view.src = `${location.pathname}/view?${new URLSearchParams({ viewpoint, heading: facing })}`;
  }

  says(step) {
    const row = this.rows[Math.min(step, this.legs.length)];
    if (!row) return "";
    const [, viewpoint, remark, walked, toGoal] = [...row.children].map((cell) => cell.textContent);
    const ahead = toGoal === "-" ? "" : `, ${toGoal} m to the goal`;
    return `${viewpoint.slice(0, 12)}, ${walked} m walked${ahead}${remark ? `, ${remark}` : ""}`;
  }
}

function makeStepper(walks) {
  const slider = document.getElementById("step");
  const play = figure.querySelector("[data-do=play]");
  const status = figure.querySelector(".at");
  const last = Math.max(...walks.map((walk) => walk.legs.length));
  let timer = 0;
  slider.max = last;
  slider.value = last;

  function show(step) {
    slider.value = step;
    walks.forEach((walk) => walk.goTo(step));
    const sentences = walks.map((walk) => walk.says(step)).filter(Boolean);
    status.hidden = false;
    status.textContent = `Step ${step} of ${last}: ${sentences.join("; compared with ")}`;
    slider.setAttribute("aria-valuetext", status.textContent);
  }

  function stop() {
    clearInterval(timer);
    timer = 0;
    play.textContent = "Play";
    status.setAttribute("aria-live", "polite");
    // A link to the page leads to the step that is shown.
    history.replaceState(null, "", `#step=${slider.value}`);
  }

  function start() {
    status.setAttribute("aria-live", "off"); // announce only the last step
    play.textContent = "Pause";
    if (Number(slider.value) >= last) show(0);
    timer = setInterval(() => {
      show(Math.min(Number(slider.value) + 1, last));
      if (Number(slider.value) === last) stop();
    }, SECONDS_A_STEP * 1000);
  }

  function move(by) {
    show(Math.min(Math.max(Number(slider.value) + by, 0), last));
    stop();
  }

  play.addEventListener("click", () => (timer ? stop() : start()));
  figure.querySelector("[data-do=back]").addEventListener("click", () => move(-1));
  figure.querySelector("[data-do=on]").addEventListener("click", () => move(1));
  slider.addEventListener("input", () => {
    clearInterval(timer);
    show(Number(slider.value));
  });
  slider.addEventListener("change", stop);
  figure.querySelector(".stepper").addEventListener("keydown", (event) => {
    if (event.target === slider || !isPlain(event)) return; // the slider has its own keys
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (by) move(by);
  });
  const linked = /^#step=(\d{1,4})$/.exec(location.hash);
  if (linked) show(Math.min(Number(linked[1]), last));
  if (last === 0) figure.querySelector(".stepper").hidden = true;
}

// Hovering over a row of a table marks its viewpoint on the map.

function makePointer() {
  const ring = element("circle", { class: "pointer", r: 11, visibility: "hidden" }, map);
  const places = new Map();
  for (const part of map.querySelectorAll("g[data-viewpoint]")) {
    const dot = part.querySelector(".viewpoint");
    if (dot) places.set(part.dataset.viewpoint, dot.getPointAtLength(0));
  }
  for (const row of document.querySelectorAll(".steps tr[data-step], .goals tr[data-viewpoint]")) {
    const place = places.get(row.querySelector(".viewpoint-id").textContent);
    if (!place) continue;
    row.addEventListener("pointerenter", () => {
      ring.setAttribute("cx", place.x);
      ring.setAttribute("cy", place.y);
      ring.setAttribute("visibility", "visible");
    });
    row.addEventListener("pointerleave", () => ring.setAttribute("visibility", "hidden"));
  }
}

// Arrow keys open the previous and the next episode, unless the focus is where they may mean more.

function isPlain(event) {
  return !(event.altKey || event.ctrlKey || event.metaKey || event.shiftKey);
}

document.addEventListener("keydown", (event) => {
  const direction = { ArrowLeft: "prev", ArrowRight: "next" }[event.key];
  if (!direction || !isPlain(event) || event.defaultPrevented) return;
  if (event.target.closest("button, input, select, summary, textarea, [tabindex]")) return;
  document.querySelector(`.pager a[rel=${direction}]`)?.click();
});

if (map) {
  const circle = map.querySelector("circle.start");
  const start = { x: circle.cx.baseVal.value, y: circle.cy.baseVal.value };
  const numbers = [...map.querySelectorAll(".stop")].map((_, index) => index + 1);
  const walks = numbers.map((number) => new Walk(number, start));
  if (walks.length) makeStepper(walks);
  const level = figure.querySelector("[data-do=level]");
  if (level) {
    level.addEventListener("change", () => chooseLevel(level.value));
    chooseLevel(level.value); // the browser may have restored another than the page has
  }
  makePointer();
}
