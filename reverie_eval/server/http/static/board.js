// The charts of a board: one metric against another, and the best over time. A copy of the board
// that is read without a server has their data in the page.
// The table has all the numbers; points have tooltips and link to their submissions.

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

function drawProgress(canvas, { progress }) {
  const paint = colours();
  const { y, points } = progress;
  const axes = { x: timeAxis("published", progress, paint), y: valueAxis(y, points.y, paint) };
  const label = (raw) => [...named(points, raw.place), `${y.heading}: ${raw.y.toFixed(2)}, ${day(points.at[raw.place])}`];
  return drawing(canvas, bestSoFar(progress, paint), axes, label, points);
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
  const { points, reported, progress } = shown;
  drawIn("against", `${shown.y.name} against ${shown.x.name}`, points.y.length + reported.y.length === 0, drawAgainst);
  drawIn("progress", `best ${progress.y.name} over time`, progress.points.y.length === 0, drawProgress);
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
