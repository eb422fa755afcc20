// A team's submissions over time, one chart per split; the table has the numbers.

const section = document.getElementById("over-time");
const charts = [];

function drawOverTime(canvas) {
  const paint = colours();
  const progress = JSON.parse(canvas.dataset.progress);
  const { y, points } = progress;
  const all = points.y.map((value, place) => ({ x: points.at[place], y: value, place }));
  const datasets = [
    ...bestSoFar(progress, paint),
    { data: all, backgroundColor: "transparent", borderColor: paint.quiet, borderWidth: 1.5, pointRadius: 4, pointHoverRadius: 6 },
  ];
  const axes = { x: timeAxis("received", progress, paint), y: valueAxis(y, points.y, paint) };
  const label = (raw) => [short(points.method[raw.place]), `${y.heading}: ${raw.y.toFixed(2)}, ${day(points.at[raw.place])}`];
  return drawing(canvas, datasets, axes, label, points);
}

function draw() {
  while (charts.length > 0) charts.pop().destroy();
  charts.push(...[...section.querySelectorAll("canvas")].map(drawOverTime));
}

if (section && prepare(section, draw)) draw();
