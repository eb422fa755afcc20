// Shared by the charts of all pages: colours of the theme, axes, and points that are links.

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
const STEPS = 3; // ticks of a time axis: as many dates as fit on a phone
const FEWEST_DAYS = 6;

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

// From the first point until now, and at least a few days; ticks are at midnight, UTC.
function timeAxis(title, { points, until }, paint) {
  const first = Math.min(...points.at, until - FEWEST_DAYS * DAY);
  const stepSize = Math.ceil((until - first) / STEPS / DAY) * DAY;
  return axis(title, paint, { min: first, max: until, ticks: { callback: day, stepSize, includeBounds: false } });
}

// A step at each point that was better than all before it; the last step extends until now.
function bestSoFar({ points, best, until }, paint) {
  const line = best.map((place) => ({ x: points.at[place], y: points.y[place], place }));
  const look = { borderColor: paint.accent, backgroundColor: paint.accent, borderWidth: 2, showLine: true };
  return [
    { ...look, data: line, stepped: "before", pointRadius: 5, pointHoverRadius: 7 },
    { ...look, data: [line.at(-1), { ...line.at(-1), x: until }], pointRadius: 0, pointHitRadius: 0 },
  ];
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

// Shows the charts, or a message that they could not be loaded.
function reveal(section, isDrawn) {
  section.querySelector(".drawn").hidden = !isDrawn;
  section.querySelector(".fault").hidden = isDrawn;
}

// Prepares a section for drawing, and redraws it when the theme changes; returns whether it worked.
function prepare(section, draw) {
  const isReady = typeof Chart === "function"; // a separate file, which may have failed to load
  reveal(section, isReady);
  if (isReady) {
    Chart.defaults.font.family = getComputedStyle(document.body).fontFamily;
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  }
  return isReady;
}
