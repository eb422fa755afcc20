// Keeps the walks that a person has finished in this browser, with their times, and offers them as a file.
// The walk is kept before the page is shown: the link to the next episode may be clicked as soon as it is there.
const { split, number, episodes, episode, record } = document.currentScript.dataset;
const { at, actions } = number ? begunWalk(split, number) : {};
if (at) {
  const seconds = Math.round((Date.now() - at) / 100) / 10;
  keepWalk(split, episode, { ...JSON.parse(record), seconds, actions });
  endWalk(split, number);
}

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
  const kept = document.getElementById("kept");
  const walks = keptWalks(split);
  const count = Object.keys(walks).length;
  kept.hidden = count === 0;
  kept.replaceChildren(
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
  if (next) document.getElementById("next").href = next.querySelector("a").href;
}

addEventListener("DOMContentLoaded", showKept);
