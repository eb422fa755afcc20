// What the charts of all pages share: colours of the theme, axes, and points that lead somewhere.

function colours() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue(name).trim();
  return {
    ink: of("--ink"), quiet: of("--quiet"), line: of("--line"),
    accent: of("--accent"), paper: of("--paper"),
  };
}

const short = (name) => (name.length > 36 ? `${name.slice(0, 35)}\u2026` : name);

const day = (milliseconds) => new Date(milliseconds).toISOString().slice(0, 10);

const DAY = 24 * 3600 * 1000;
const STEPS = 3; // of time, as many as have room for their dates on a phone
const FEWEST_DAYS = 6;

// Where the least is next to nothing, room below it would be room for negative numbers.
const startsNearZero = (values) => Math.min(...values) < 0.1 * Math.max(...values);

// Where the most is close to all there can be, room above it would be room for the impossible.
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

// From the first of them until now, a few days at least; ticks are at midnight, UTC.
function timeAxis(title, { points, until }, paint) {
  const first = Math.min(...points.at, until - FEWEST_DAYS * DAY);
  const stepSize = Math.ceil((until - first) / STEPS / DAY) * DAY;
  return axis(title, paint, { min: first, max: until, ticks: { callback: day, stepSize, includeBounds: false } });
}

// A step at each point that was better than all before it; the last of them holds until now.
function bestSoFar({ points, best, until }, paint) {
  const line = best.map((place) => ({ x: points.at[place], y: points.y[place], place }));
  const look = { borderColor: paint.accent, backgroundColor: paint.accent, borderWidth: 2, showLine: true };
  return [
    { ...look, data: line, stepped: "before", pointRadius: 5, pointHoverRadius: 7 },
    { ...look, data: [line.at(-1), { ...line.at(-1), x: until }], pointRadius: 0, pointHitRadius: 0 },
  ];
}

function drawing(canvas, datasets, axes, label, points) {
  const paint = colours();
  return new Chart(canvas, {
    type: "scatter",
    data: { datasets },
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
        const { place } = chart.data.datasets[datasetIndex].data[index];
        location.href = `/submissions/${points.submission[place]}`;
      },
    },
  });
}

// Shows what is drawn, or else that nothing could be.
function reveal(section, isDrawn) {
  section.querySelector(".drawn").hidden = !isDrawn;
  section.querySelector(".fault").hidden = isDrawn;
}

// Makes a section ready to be drawn in, also again when the theme changes; returns whether it is.
function prepare(section, draw) {
  const isReady = typeof Chart === "function"; // a file of its own, which may not have arrived
  reveal(section, isReady);
  if (isReady) {
    Chart.defaults.font.family = getComputedStyle(document.body).fontFamily;
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  }
  return isReady;
}
