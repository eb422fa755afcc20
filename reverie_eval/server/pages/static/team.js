// A team's submissions over time, a chart for each split; the table has the numbers.

const canvases = document.querySelectorAll("canvas[data-progress]");
const charts = [];

function drawOverTime(canvas) {
  const paint = colours();
  const { y, points, best } = JSON.parse(canvas.dataset.progress);
  const all = points.y.map((value, place) => ({ x: points.at[place], y: value, place }));
  const datasets = [
    ...bestSoFar(points, best, paint),
    { data: all, backgroundColor: "transparent", borderColor: paint.quiet, borderWidth: 1.5, pointRadius: 4, pointHoverRadius: 6 },
  ];
  const axes = { x: timeAxis("received", paint), y: axis(y.heading, paint, { values: points.y }) };
  const label = (raw) => [short(points.method[raw.place]), `${y.heading}: ${raw.y.toFixed(2)}, ${day(points.at[raw.place])}`];
  return drawing(canvas, datasets, axes, label, points);
}

function draw() {
  while (charts.length > 0) charts.pop().destroy();
  charts.push(...[...canvases].map(drawOverTime));
}

if (canvases.length > 0) {
  document.getElementById("over-time").hidden = false;
  Chart.defaults.font.family = getComputedStyle(document.body).fontFamily;
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();
}
