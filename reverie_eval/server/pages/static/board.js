// The charts of a board: one metric against another, and the best over time. A copy of the board
// that is read without a server has their data in the page.
// The table has all the numbers; points have tooltips and link to their submissions.

const section = document.getElementById("charts");
const charts = [];

function named(points, place) {
  const rank = points.rank[place] === null ? "" : `${points.rank[place]}. `;
  return [`${rank}${short(points.method[place])}`, short(points.team[place])];
}

function drawAgainst(canvas, data) {
  const paint = colours();
  const { points, front } = data;
  const at = (place) => ({ x: points.x[place], y: points.y[place], place });
  const onFront = new Set(front);
  const rest = points.x.map((_, place) => place).filter((place) => !onFront.has(place));
  const many = points.x.length > 500;
  const datasets = [
    { data: front.map(at), showLine: true, borderColor: paint.accent, borderDash: [5, 4], borderWidth: 1.5, backgroundColor: paint.accent, pointRadius: 5, pointHoverRadius: 7 },
    { data: rest.map(at), backgroundColor: "transparent", borderColor: paint.quiet, borderWidth: 1.5, pointRadius: many ? 1.5 : 4, pointHoverRadius: 6 },
  ];
  const axes = { x: valueAxis(data.x, points.x, paint), y: valueAxis(data.y, points.y, paint) };
  const label = (raw) => [...named(points, raw.place), `${data.y.heading}: ${raw.y.toFixed(2)}, ${data.x.heading}: ${raw.x.toFixed(2)}`];
  return drawing(canvas, datasets, axes, label, points);
}

function drawProgress(canvas, { progress }) {
  const paint = colours();
  const { y, points } = progress;
  const axes = { x: timeAxis("published", progress, paint), y: valueAxis(y, points.y, paint) };
  const label = (raw) => [...named(points, raw.place), `${y.heading}: ${raw.y.toFixed(2)}, ${day(points.at[raw.place])}`];
  return drawing(canvas, bestSoFar(progress, paint), axes, label, points);
}

let shown;

function drawIn(name, words, { points }, how) {
  const canvas = document.getElementById(name);
  canvas.setAttribute("aria-label", `Chart: ${words}; the table has the numbers`);
  const isEmpty = points.y.length === 0;
  canvas.closest("figure").classList.toggle("empty", isEmpty);
  if (!isEmpty) charts.push(how(canvas, shown));
}

function draw() {
  while (charts.length > 0) charts.pop().destroy();
  if (!shown) return;
  drawIn("against", `${shown.y.name} against ${shown.x.name}`, shown, drawAgainst);
  drawIn("progress", `best ${shown.progress.y.name} over time`, shown.progress, drawProgress);
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
    reveal(section, true);
    draw();
  } catch {
    if (!signal.aborted) reveal(section, false);
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
  for (const link of document.querySelectorAll("main a[href]:not([href^='#'])")) {
    if (link.href.startsWith(location.origin + location.pathname)) link.href = withAxis(link.href);
  }
  for (const field of document.querySelectorAll(`.filters [name=${name}]`)) field.value = value;
}

if (section && prepare(section, draw)) {
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
