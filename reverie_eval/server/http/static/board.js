// The chart of a board: one metric against another. A copy of the board that is read without a server
// has its data in the page. The table has all the numbers; points have tooltips and link to their submissions.

function colours() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue(name).trim();
  return {
    ink: of("--ink"), quiet: of("--quiet"), line: of("--line"),
    accent: of("--accent"), paper: of("--paper"),
  };
}

const short = (name) => (name.length > 36 ? `${name.slice(0, 35)}\u2026` : name);

// If the smallest value is close to 0, padding below it would show negative numbers.
const startsNearZero = (values) => Math.min(...values) < 0.1 * Math.max(...values);

// If the largest value is close to the maximum, padding above it would show impossible numbers.
const endsAtAll = (values, most) => most !== null && Math.max(...values) > 0.9 * most;

function axis(title, paint, more = {}) {
  return {
    type: "linear",
    title: { display: true, text: title, color: paint.ink },
    grid: { color: paint.line },
    border: { color: paint.quiet },
    ...more,
    ticks: { color: paint.quiet, maxRotation: 0, ...more.ticks },
  };
}

function valueAxis({ heading, most }, values, paint) {
  const max = endsAtAll(values, most) ? most : undefined;
  return axis(heading, paint, { grace: "6%", beginAtZero: startsNearZero(values), max });
}

function drawing(canvas, datasets, axes, label, points, plugins = []) {
  const paint = colours();
  return new Chart(canvas, {
    type: "scatter",
    data: { datasets },
    plugins,
    options: {
      animation: false,
      clip: 8, // points on the edge are drawn whole
      interaction: { mode: "nearest", intersect: true },
      maintainAspectRatio: false,
      scales: axes,
      plugins: {
        legend: { display: false },
        tooltip: {
          backgroundColor: paint.ink, titleColor: paint.paper, bodyColor: paint.paper,
          displayColors: false,
          callbacks: { title: () => "", label: (item) => label(item.raw) },
        },
      },
      onHover: (event, found) => { event.native.target.classList.toggle("leads", found.length > 0); },
      onClick: (event, found, chart) => {
        if (found.length === 0) return;
        const { datasetIndex, index } = found[0];
        const { place, from = points } = chart.data.datasets[datasetIndex].data[index];
        const submission = from.submission[place];
        if (submission !== null) location.href = chart.canvas.closest("section").dataset.submission.replace("ID", submission);
      },
    },
  });
}

// Shows the chart, or a message that it could not be loaded.
function reveal(isDrawn) {
  section.querySelector(".drawn").hidden = !isDrawn;
  section.querySelector(".fault").hidden = isDrawn;
}

// Prepares the section for drawing, and redraws it when the theme changes; returns whether it worked.
function prepare() {
  const isReady = typeof Chart === "function"; // a separate file, which may have failed to load
  reveal(isReady);
  if (isReady) {
    Chart.defaults.font.family = getComputedStyle(document.body).fontFamily;
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  }
  return isReady;
}

const section = document.getElementById("charts");
const charts = [];
const MOST_NAMES = 12;
const SMALL = "11px system-ui, sans-serif";

function named(points, place) {
  const rank = points.rank[place] === null ? "" : `${points.rank[place]}. `;
  return [`${rank}${short(points.method[place])}`, short(points.team[place])];
}

const at = (from) => (place) => ({ x: from.x[place], y: from.y[place], place, from });

function drawAgainst(canvas, data) {
  const paint = colours();
  const { points, front, reported, lines } = data;
  const onFront = new Set(front);
  const rest = points.x.map((_, place) => place).filter((place) => !onFront.has(place));
  const many = points.x.length > 500;
  const datasets = [
    { data: front.map(at(points)), showLine: true, borderColor: paint.accent, borderDash: [5, 4], borderWidth: 1.5, backgroundColor: paint.accent, pointRadius: 5, pointHoverRadius: 7 },
    { data: rest.map(at(points)), backgroundColor: "transparent", borderColor: paint.ink, borderWidth: 1.5, pointRadius: many ? 1.5 : 4, pointHoverRadius: 6 },
    { data: reported.x.map((_, place) => at(reported)(place)), backgroundColor: paint.line, borderColor: paint.quiet, borderWidth: 1, pointRadius: many ? 1 : 3, pointHoverRadius: 5 },
  ];
  const across = [...points.x, ...reported.x];
  const up = [...points.y, ...reported.y, ...lines.map((line) => line.y)];
  const axes = { x: valueAxis(data.x, across, paint), y: valueAxis(data.y, up, paint) };
  axes.y.suggestedMin = Math.min(...up);
  axes.y.suggestedMax = Math.max(...up);
  const label = (raw) => [...named(raw.from, raw.place), `${data.y.heading}: ${raw.y.toFixed(2)}, ${data.x.heading}: ${raw.x.toFixed(2)}`];
  return drawing(canvas, datasets, axes, label, points, [linesAcross(lines, paint), namesBeside(points, paint)]);
}

// Values to compare with, as lines with their names.
function linesAcross(lines, paint) {
  return {
    id: "lines",
    beforeDatasetsDraw({ ctx, chartArea, scales }) {
      ctx.save();
      ctx.font = SMALL;
      ctx.fillStyle = paint.quiet;
      ctx.strokeStyle = paint.quiet;
      ctx.setLineDash([2, 3]);
      for (const { name, y } of lines) {
        const height = scales.y.getPixelForValue(y);
        ctx.beginPath();
        ctx.moveTo(chartArea.left, height);
        ctx.lineTo(chartArea.right, height);
        ctx.stroke();
        ctx.fillText(`${name} ${y.toFixed(2)}`, chartArea.left + 4, height - 4);
      }
      ctx.restore();
    },
  };
}

// Names of points, of the front first, as far as there is room for them between the points.
function namesBeside(points, paint) {
  return {
    id: "names",
    afterDatasetsDraw(chart) {
      const { ctx, chartArea } = chart;
      const circles = chart.data.datasets.flatMap((_, set) => chart.getDatasetMeta(set).data);
      const taken = circles.map(({ x, y }) => ({ left: x - 4, right: x + 4, top: y - 4, bottom: y + 4 }));
      const most = taken.length + MOST_NAMES;
      ctx.save();
      ctx.font = SMALL;
      ctx.fillStyle = paint.ink;
      for (const set of [0, 1]) {
        chart.getDatasetMeta(set).data.forEach((element, index) => {
          const name = points.method[chart.data.datasets[set].data[index].place];
          const text = name.length > 16 ? `${name.slice(0, 15)}\u2026` : name;
          const width = ctx.measureText(text).width;
          const left = element.x + 7 + width > chartArea.right ? element.x - 7 - width : element.x + 7;
          const box = { left, right: left + width, top: element.y - 9, bottom: element.y + 4 };
          if (taken.length === most || left < chartArea.left || taken.some((other) => overlap(box, other))) return;
          taken.push(box);
          ctx.fillText(text, left, element.y + 1);
        });
      }
      ctx.restore();
    },
  };
}

function overlap(one, other) {
  return one.left < other.right && other.left < one.right && one.top < other.bottom && other.top < one.bottom;
}

let shown;

function drawIn(name, words, isEmpty, how) {
  const canvas = document.getElementById(name);
  canvas.setAttribute("aria-label", `Chart: ${words}; the table has the numbers`);
  canvas.closest("figure").classList.toggle("empty", isEmpty);
  if (!isEmpty) charts.push(how(canvas, shown));
}

function draw() {
  while (charts.length > 0) charts.pop().destroy();
  if (!shown) return;
  const { points, reported } = shown;
  drawIn("against", `${shown.y.name} against ${shown.x.name}`, points.y.length + reported.y.length === 0, drawAgainst);
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
  for (const link of document.querySelectorAll("main a[href]:not([href^='#'])")) {
    if (link.href.startsWith(location.origin + location.pathname)) link.href = withAxis(link.href);
  }
  for (const field of document.querySelectorAll(`.filters [name=${name}]`)) field.value = value;
}

if (section && prepare()) {
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
