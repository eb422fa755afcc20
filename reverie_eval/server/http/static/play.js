// Keeps the walks that a person has finished in this browser, with their times, and offers them as a file.
const place = document.querySelector("[data-play='scored'], [data-play='kept']");
const { split, number, episodes } = place.dataset;

function download(name, type, text) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type }));
  link.download = name;
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
  const walks = keptWalks(split);
  const count = Object.keys(walks).length;
  place.hidden = count === 0;
  place.replaceChildren(
    `${count} ${count === 1 ? "walk is" : "walks are"} kept in this browser. `,
    button("Download", () => download(`${split}.human.json`, "application/json", JSON.stringify(Object.values(walks), null, 1))),
    " ",
    button("List of episodes", () => download(`${split}.human.txt`, "text/plain", `${Object.keys(walks).join("\n")}\n`)),
    " ",
    button("Forget", () => {
      forgetWalks(split);
      location.reload();
    }, "risky"),
  );
  const isWhole = count === Number(episodes);
  for (const each of document.querySelectorAll("[data-if]")) {
    each.hidden = count === 0 || (each.dataset.if === "whole") !== isWhole;
  }
  for (const item of document.querySelectorAll(".sampled [data-episode]")) {
    if (item.dataset.episode in walks) item.append(" ✓ walked");
  }
  const next = [...document.querySelectorAll(".sampled [data-episode]")]
    .find((item) => !(item.dataset.episode in walks));
  if (next) document.querySelector("[data-play='next']").href = next.querySelector("a").href;
}

const { at, actions } = number ? begunWalk(split, number) : {};
if (at) {
  const seconds = Math.round((Date.now() - at) / 100) / 10;
  keepWalk(split, place.dataset.episode, { ...JSON.parse(place.dataset.record), seconds, actions });
  endWalk(split, number);
}
showKept();
