// The charts of a board: one metric against another, and the best over time.
// The table has every number; what is drawn here can be pointed at and followed.

const section = document.getElementById("charts");
const charts = [];

function named(points, place) {
  const rank = points.rank[place] === null ? "" : `${points.rank[place]}. `;
  return [`${rank}${short(points.method[place])}`, short(points.team[place])];
}

function drawAgainst(data) {
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
  const axes = {
    x: axis(data.x.heading, paint, { values: points.x }),
    y: axis(data.y.heading, paint, { values: points.y }),
  };
  const label = (raw) => [...named(points, raw.place), `${data.y.heading}: ${raw.y.toFixed(2)}, ${data.x.heading}: ${raw.x.toFixed(2)}`];
  return drawing(document.getElementById("against"), datasets, axes, label, points);
}

function drawProgress(data) {
  const paint = colours();
  const { points, best } = data;
  const axes = { x: timeAxis("published", paint), y: axis(data.y.heading, paint, { values: points.y }) };
  const label = (raw) => [...named(points, raw.place), `${data.y.heading}: ${raw.y.toFixed(2)}, ${day(points.at[raw.place])}`];
  return drawing(document.getElementById("progress"), bestSoFar(points, best, paint), axes, label, points);
}

let shown;

function draw() {
  while (charts.length > 0) charts.pop().destroy();
  const names = `${shown.y.name} against ${shown.x.name}`;
  document.getElementById("against").setAttribute("aria-label", `Chart: ${names}; the table has the numbers`);
  document.getElementById("progress").setAttribute("aria-label", `Chart: best ${shown.y.name} over time; the table has the numbers`);
  charts.push(drawAgainst(shown), drawProgress(shown));
}

async function load() {
  const source = new URL(section.dataset.source, location.href);
  for (const select of section.querySelectorAll("select")) source.searchParams.set(select.name, select.value);
  const fault = section.querySelector(".fault");
  try {
    const reply = await fetch(source);
    if (!reply.ok) throw new Error(reply.statusText);
    shown = await reply.json();
    fault.hidden = true;
    draw();
  } catch {
    fault.hidden = false;
  }
}

if (section) {
  section.querySelector(".charts").hidden = false;
  Chart.defaults.font.family = getComputedStyle(document.body).fontFamily;
  for (const select of section.querySelectorAll("select")) {
    select.addEventListener("change", () => {
      const here = new URL(location.href); // the axes are in the address too
      here.searchParams.set(select.name, select.value);
      history.replaceState(null, "", here);
      load();
    });
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => shown && draw());
  load();
}
