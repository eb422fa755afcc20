// The walks that a person has finished, which this browser keeps by split and episode.

const keptName = (split) => `reverie-eval walks ${split}`;

function keptWalks(split) {
  return JSON.parse(localStorage.getItem(keptName(split)) ?? "{}");
}

function keepWalk(split, episode, walk) {
  const walks = { ...keptWalks(split), [episode]: walk };
  localStorage.setItem(keptName(split), JSON.stringify(walks));
}

function forgetWalks(split) {
  localStorage.removeItem(keptName(split));
}

// The walk that is under way in this window: when it began, and the actions so far with the answer to come.

const begunName = (split, number) => `reverie-eval walk ${split} ${number}`;

function begunWalk(split, number) {
  return JSON.parse(sessionStorage.getItem(begunName(split, number)) ?? "{}");
}

function countAction({ split, number }) {
  const isStart = !new URLSearchParams(location.search).get("walk");
  const begun = begunWalk(split, number);
  const { at, actions } = isStart || !begun.at ? { at: Date.now(), actions: 0 } : begun;
  sessionStorage.setItem(begunName(split, number), JSON.stringify({ at, actions: actions + 1 }));
}

function endWalk(split, number) {
  sessionStorage.removeItem(begunName(split, number));
}

// A page on which a person walks is counted before it is shown, because they may walk on or answer at once.
const walk = document.currentScript.dataset;
if (walk.number) countAction(walk);

// The walks as a submission, without their times, which nobody but the person gets; null if none is kept.
function walksFile(split) {
  const records = Object.values(keptWalks(split)).map(({ seconds, actions, ...record }) => record);
  if (records.length === 0) return null;
  return new File([JSON.stringify(records)], `${split}.human.json`, { type: "application/json" });
}
