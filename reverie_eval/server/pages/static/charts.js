// What the charts of all pages share: colours of the theme, axes, and points that lead somewhere.

function colours() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue(name).trim();
  return {
    ink: of("--ink"), quiet: of("--quiet"), line: of("--line"),
    accent: of("--accent"), paper: of("--paper"), good: of("--good"),
  };
}

const short = (name) => (name.length > 36 ? `${name.slice(0, 35)}\u2026` : name);

const day = (milliseconds) => new Date(milliseconds).toISOString().slice(0, 10);

// Where the least is next to nothing, room below it would be room for negative numbers.
const startsNearZero = (values) => Math.min(...values) < 0.1 * Math.max(...values);

function axis(title, paint, more = {}) {
  return {
    type: "linear",
    title: { display: true, text: title, color: paint.ink },
    grid: { color: paint.line },
    border: { color: paint.quiet },
    ticks: { color: paint.quiet, maxRotation: 0, ...more.ticks },
    grace: more.grace ?? "6%",
    beginAtZero: startsNearZero(more.values ?? []),
  };
}

const timeAxis = (title, paint) => axis(title, paint, { grace: 0, ticks: { callback: day, maxTicksLimit: 5 } });

// A step at each point that was better than all before it; the last of them holds until now.
function bestSoFar(points, best, paint) {
  const line = best.map((place) => ({ x: points.at[place], y: points.y[place], place }));
  const look = { borderColor: paint.accent, backgroundColor: paint.accent, borderWidth: 2, showLine: true };
  const now = { ...line.at(-1), x: Math.max(...points.at) };
  return [
    { ...look, data: line, stepped: "before", pointRadius: 5, pointHoverRadius: 7 },
    { ...look, data: [line.at(-1), now], pointRadius: 0, pointHitRadius: 0 },
  ];
}

function drawing(canvas, datasets, axes, label, points) {
  const paint = colours();
  return new Chart(canvas, {
    type: "scatter",
    data: { datasets },
    options: {
      animation: false,
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
