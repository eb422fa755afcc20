// Keeps the walks that a person has finished in this browser, with their times, and offers them as a file.
const place = document.querySelector("[data-play='walking'], [data-play='scored'], [data-play='kept']");
const { split, episode } = place.dataset;
const KEPT = `reverie-eval walks ${split}`;
const BEGUN = `reverie-eval walk ${split} ${episode}`;

function read(storage, key) {
  return JSON.parse(storage.getItem(key) ?? "{}");
}

function download(walks) {
  const records = Object.values(walks);
  const file = new Blob([JSON.stringify(records, null, 1)], { type: "application/json" });
  const link = document.createElement("a");
  link.href = URL.createObjectURL(file);
  link.download = `${split}.human.json`;
  link.click();
  URL.revokeObjectURL(link.href);
}

function button(text, act, look = "second") {
  const made = document.createElement("button");
  made.type = "button";
  made.className = look;
  made.textContent = text;
  made.addEventListener("click", act);
  return made;
}

function showKept() {
  const walks = read(localStorage, KEPT);
  const count = Object.keys(walks).length;
  place.hidden = count === 0;
  place.replaceChildren(
    `${count} ${count === 1 ? "walk is" : "walks are"} kept in this browser. `,
    button("Download", () => download(walks)),
    " ",
    button("Forget", () => {
      localStorage.removeItem(KEPT);
      location.reload();
    }, "risky"),
  );
  for (const item of document.querySelectorAll(".sampled [data-episode]")) {
    if (item.dataset.episode in walks) item.append(" ✓ walked");
  }
  const next = [...document.querySelectorAll(".sampled [data-episode]")]
    .find((item) => !(item.dataset.episode in walks));
  if (next) document.querySelector("[data-play='next']").href = next.querySelector("a").href;
}

if (place.dataset.play === "walking") {
  const around = document.querySelector(".panorama").parentElement;
  around.scrollLeft = (around.scrollWidth - around.clientWidth) / 2;
  const begun = read(sessionStorage, BEGUN);
  const again = !location.search.includes("walk=");
  const walk = again || !begun.at ? { at: Date.now(), actions: 0 } : begun;
  sessionStorage.setItem(BEGUN, JSON.stringify({ ...walk, actions: walk.actions + 1 }));
} else if (place.dataset.play === "scored") {
  const begun = read(sessionStorage, BEGUN);
  if (begun.at) {
    const record = JSON.parse(place.dataset.record);
    const seconds = Math.round((Date.now() - begun.at) / 100) / 10;
    const walks = { ...read(localStorage, KEPT), [episode]: { ...record, seconds, actions: begun.actions } };
    localStorage.setItem(KEPT, JSON.stringify(walks));
    sessionStorage.removeItem(BEGUN);
  }
  showKept();
} else {
  showKept();
}
