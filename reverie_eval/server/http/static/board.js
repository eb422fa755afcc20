// The chart of a board: one metric against another. A copy of the board that is read without a server
// has its data in the page. The table has all the numbers; points have tooltips and link to their submissions.

const SVG = "http://www.w3.org/2000/svg";
const LEFT = 46, RIGHT = 12, TOP = 10, BOTTOM = 44;
const LETTER = 6.2, LINE = 13; // the size of names, in pixels
const MOST_NAMES = 12;
const MANY = 500; // points, which are smaller then
const section = document.getElementById("charts");
const chart = document.getElementById("against");
let shown;

function element(name, attributes, parent, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  parent.append(made);
  return made;
}

const short = (name, most) => (name.length > most ? `${name.slice(0, most - 1)}\u2026` : name);

// An axis with ticks at round numbers; nothing is shown that the metric cannot be, below 0 or above its most.
function axisOf(values, { most }, start, end) {
  const [lowest, highest] = [Math.min(...values), Math.max(...values)];
  const margin = 0.06 * (highest - lowest) || 1;
  const low = lowest < 0.1 * highest ? Math.min(lowest, 0) : lowest - margin;
  const high = most !== null && highest > 0.9 * most ? most : highest + margin;
  const rough = (high - low) / Math.max(2, Math.abs(end - start) / 60);
  const digit = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((times) => times * digit).find((each) => each >= rough);
  const ticks = [];
  for (let tick = Math.ceil(low / step - 1e-9) * step; tick <= high + 1e-9 * step; tick += step) ticks.push(Number(tick.toPrecision(6)));
  return { ticks, at: (value) => start + (end - start) * (value - low) / (high - low) };
}

// Without a result that has both metrics, the page says so instead.
function draw() {
  if (!shown) return;
  const { points, front, reported, lines } = shown;
  chart.setAttribute("aria-label", `Chart: ${shown.y.name} against ${shown.x.name}; the table has the numbers`);
  const isEmpty = points.y.length + reported.y.length === 0;
  chart.closest("figure").classList.toggle("empty", isEmpty);
  chart.replaceChildren();
  if (isEmpty) return;
  const { width, height } = chart.getBoundingClientRect();
  chart.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const x = axisOf([...points.x, ...reported.x], shown.x, LEFT, width - RIGHT);
  const y = axisOf([...points.y, ...reported.y, ...lines.map((line) => line.y)], shown.y, height - BOTTOM, TOP);
  drawAxes(x, y, width, height);
  for (const line of lines) element("path", { class: "count", d: `M${LEFT} ${y.at(line.y)}H${width - RIGHT}` }, chart);
  const onFront = new Set(front);
  const rest = points.x.map((_, index) => index).filter((index) => !onFront.has(index));
  const of = (from) => (index) => ({ from, index, x: x.at(from.x[index]), y: y.at(from.y[index]) });
  const best = front.map(of(points)), others = rest.map(of(points));
  if (best.length > 1) element("path", { class: "front-line", d: `M${best.map((it) => `${it.x} ${it.y}`).join("L")}` }, chart);
  const scale = points.x.length > MANY ? 0.4 : 1;
  const elsewhere = reported.x.map((_, index) => of(reported)(index));
  drawPoints("reported", elsewhere, 3 * scale);
  drawPoints("rest", others, 4 * scale);
  drawPoints("front", best, 5);
  const taken = [...best, ...others, ...elsewhere].map(({ x: across, y: up }) => around(across, up, 4));
  const compared = lines.map((line) => ({ name: `${line.name} ${line.y.toFixed(2)}`, at: y.at(line.y) }));
  const names = nameLines(compared, taken, width, height);
  namePoints([...best, ...others], [...taken, ...names], width);
}

function drawAxes(x, y, width, height) {
  const axes = { x: element("g", { class: "axis-x" }, chart), y: element("g", { class: "axis-y" }, chart) };
  for (const tick of x.ticks) {
    element("path", { class: "axis", d: `M${x.at(tick)} ${TOP}V${height - BOTTOM}` }, axes.x);
    element("text", { class: "tick", x: x.at(tick), y: height - BOTTOM + 16, "text-anchor": "middle" }, axes.x, tick);
  }
  for (const tick of y.ticks) {
    element("path", { class: "axis", d: `M${LEFT} ${y.at(tick)}H${width - RIGHT}` }, axes.y);
    element("text", { class: "tick", x: LEFT - 6, y: y.at(tick) + 4, "text-anchor": "end" }, axes.y, tick);
  }
  const middle = (TOP + height - BOTTOM) / 2;
  element("text", { class: "title", x: (LEFT + width - RIGHT) / 2, y: height - 8, "text-anchor": "middle" }, axes.x, shown.x.heading);
  element("text", { class: "title", transform: `translate(12 ${middle}) rotate(-90)`, "text-anchor": "middle" }, axes.y, shown.y.heading);
}

function drawPoints(kind, all, radius) {
  const group = element("g", { class: kind }, chart);
  for (const { from, index, x, y } of all) {
    const submission = from.submission[index];
    const href = section.dataset.submission.replace("ID", submission);
    const parent = submission === null ? group : element("a", { href, tabindex: -1 }, group); // the table has links for keys
    const rank = from.rank[index] === null ? "" : `${from.rank[index]}. `;
    const told = [
      `${rank}${short(from.method[index], 36)}`, short(from.team[index], 36),
      `${shown.y.heading}: ${from.y[index].toFixed(2)}, ${shown.x.heading}: ${from.x[index].toFixed(2)}`,
    ];
    element("title", {}, element("circle", { cx: x, cy: y, r: radius }, parent), told.join("\n"));
  }
}

const around = (x, y, radius) => ({ left: x - radius, right: x + radius, top: y - radius, bottom: y + radius });
const overlap = (one, other) => one.left < other.right && other.left < one.right && one.top < other.bottom && other.top < one.bottom;

// Names of lines, each at the end and on the side of its line where it covers the fewest points, and no other name.
function nameLines(lines, taken, width, height) {
  const names = [];
  for (const { name, at } of lines) {
    const long = LETTER * name.length;
    const places = [];
    for (const base of [at - 4, at + LINE]) {
      for (const left of [LEFT + 4, width - RIGHT - 4 - long]) {
        const box = { left, right: left + long, top: base - LINE + 3, bottom: base + 3 };
        const covers = taken.filter((each) => overlap(box, each)).length;
        if (box.top >= 0 && box.bottom <= height - BOTTOM && !names.some((each) => overlap(box, each))) places.push({ box, base, covers });
      }
    }
    if (places.length === 0) continue; // a chart too low for them; points have their values
    const { box, base } = places.reduce((best, each) => (each.covers < best.covers ? each : best));
    names.push(box);
    element("text", { class: "name of-line", x: box.left, y: base }, chart, name);
  }
  return names;
}

// Names of points, of the front first, as far as there is room for them.
function namePoints(all, taken, width) {
  let named = 0;
  for (const { from, index, x, y } of all) {
    if (named === MOST_NAMES) break;
    const name = short(from.method[index], 16);
    const long = LETTER * name.length;
    const isLeft = x + 7 + long > width - RIGHT;
    const left = isLeft ? x - 7 - long : x + 7;
    const box = { left, right: left + long, top: y - LINE / 2, bottom: y + LINE / 2 };
    if (left < LEFT || taken.some((each) => overlap(box, each))) continue;
    taken.push(box);
    named += 1;
    element("text", { class: "name", x: isLeft ? x - 7 : left, y: y + 4, "text-anchor": isLeft ? "end" : "start" }, chart, name);
  }
}

// Shows the chart, or a message that it could not be loaded.
function reveal(isDrawn) {
  section.querySelector(".drawn").hidden = !isDrawn;
  section.querySelector(".fault").hidden = isDrawn;
}

let underWay;

async function load() {
  underWay?.abort(); // a late reply to an earlier request must not be drawn with the new axes
  underWay = new AbortController();
  const { signal } = underWay;
  const source = new URL(section.dataset.source, location.href);
  for (const select of section.querySelectorAll("select")) source.searchParams.set(select.name, select.value);
  try {
    const reply = await fetch(source, { signal });
    if (!reply.ok) throw new Error(reply.statusText);
    shown = await reply.json();
    reveal(true);
    draw();
  } catch {
    if (!signal.aborted) reveal(false);
  }
}

// Keeps the chosen axes in the page's address, in its links, and in the filter form.
function keep({ name, value }) {
  const withAxis = (address) => {
    const changed = new URL(address);
    changed.searchParams.set(name, value);
    return changed;
  };
  history.replaceState(null, "", withAxis(location.href));
  for (const link of document.querySelectorAll("main a[href]:not([href^='#'], .chart a)")) {
    if (link.href.startsWith(location.origin + location.pathname)) link.href = withAxis(link.href);
  }
  for (const field of document.querySelectorAll(`.filters [name=${name}]`)) field.value = value;
}

if (section) {
  reveal(true);
  new ResizeObserver(draw).observe(chart.parentElement);
  for (const select of section.querySelectorAll("select")) {
    select.addEventListener("change", () => {
      keep(select);
      load();
    });
  }
  if (section.dataset.chart) {
    shown = JSON.parse(section.dataset.chart);
    draw();
  } else {
    load();
  }
}

// Results are compared when two are ticked; until then, and with a third, there is nothing to press.
const compare = document.getElementById("compare");

function allowTwo() {
  const ticks = [...compare.elements].filter(({ name }) => name === "result");
  const ticked = ticks.filter(({ checked }) => checked).length;
  compare.querySelector("button").disabled = ticked !== 2;
  compare.querySelector("span").hidden = ticked === 2;
  for (const tick of ticks) tick.disabled = ticked >= 2 && !tick.checked;
}

if (compare) {
  document.addEventListener("change", ({ target }) => {
    if (target.form === compare) allowTwo();
  });
  addEventListener("pageshow", allowTwo); // with ticks that the browser restores
}
