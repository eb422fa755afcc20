// Walks an episode by keyboard and pointer. A step replaces parts of the page, so that the focus stays where it is.

const walked = document.getElementById("walked");
const ahead = document.getElementById("ahead");
const panorama = document.getElementById("panorama");
const ways = document.getElementById("ways");
const answer = document.getElementById("answer");
const PARTS = [walked, ahead, panorama, ways, answer, document.getElementById("been")];
const SAME_POINT = 4; // pixels
let facing; // the link of the way that the person faces
let pointed = { x: -1, y: -1 };
let isUnderWay = false;
let loads = 0; // so far; only what was asked for last is shown

const linksTo = (what) => [ahead, panorama].flatMap((part) => [...part.querySelectorAll(`a[data-${what}]`)]);
const ownWays = () => [...panorama.querySelectorAll("a[data-way]")]; // all of them, each once

function say(words) {
  document.getElementById("facing").textContent = words;
}

// Turns to the way that is nearest to the middle.
function faceAhead() {
  const { left, width } = panorama.firstElementChild.getBoundingClientRect();
  const fromAhead = (link) => {
    const circle = link.getBoundingClientRect();
    return Math.abs(circle.left + circle.width / 2 - left - width / 2);
  };
  face(ownWays().toSorted((one, other) => fromAhead(one) - fromAhead(other))[0]);
}

async function load(address, parts) {
  const reply = await fetch(address);
  const page = new DOMParser().parseFromString(await reply.text(), "text/html");
  if (!reply.ok || !page.getElementById("ways")) throw new Error(reply.statusText);
  return () => {
    for (const part of parts) part.replaceChildren(...page.getElementById(part.id).childNodes);
  };
}

async function show(address) {
  isUnderWay = true;
  loads += 1;
  const own = loads;
  try {
    const replace = await load(address, PARTS);
    if (own !== loads) return; // they have gone back or forward since
    const hadFocus = PARTS.some((part) => part.contains(document.activeElement));
    replace();
    if (hadFocus) panorama.focus({ preventScroll: true });
    pointed = { x: -1, y: -1 };
    countAction(walk);
    faceAhead();
    isUnderWay = false;
  } catch {
    if (own === loads) location.assign(address); // the browser shows what is wrong
  }
}

// Draws both pictures anew for where the person has turned to; what they face and have chosen stays.
async function look(address) {
  if (isUnderWay) return;
  loads += 1;
  const own = loads;
  try {
    const replace = await load(address, [ahead, panorama]);
    if (own !== loads) return; // they have turned or gone on since
    replace();
    history.replaceState(null, "", address);
    if (answer.elements.answer.value) markChosen();
    else faceAhead();
  } catch {
    if (own === loads) location.assign(address);
  }
}

async function go(link) {
  if (isUnderWay) return;
  const address = new URL(link.getAttribute("href"), location);
  history.pushState(null, "", address);
  await show(address);
}

// Turns to a way; to none, if an object is chosen instead.
function face(link) {
  facing?.classList.remove("facing");
  facing = link;
  if (!link) return;
  say(`You face ${link.getAttribute("aria-label")}.`);
  link.classList.add("facing");
  const { left, width } = link.getBoundingClientRect();
  panorama.scrollLeft += left + width / 2 - panorama.getBoundingClientRect().left - panorama.clientWidth / 2;
}

function turn(step) {
  const all = ownWays().toSorted((one, other) => one.dataset.way - other.dataset.way);
  if (!all.length) return;
  face(all.at((all.indexOf(facing) + step) % all.length));
  const address = new URL(location);
  address.searchParams.set("facing", facing.dataset.heading % 360);
  look(address);
}

// Chooses the object at a point; another click at the same point chooses the one below it.
function point({ clientX: x, clientY: y }) {
  const below = document.elementsFromPoint(x, y).map((each) => each.closest("a[data-object]")?.dataset.object);
  const objects = [...new Set(below)].filter(Boolean);
  const isSame = Math.hypot(x - pointed.x, y - pointed.y) < SAME_POINT;
  const next = isSame ? (objects.indexOf(answer.elements.answer.value) + 1) % objects.length : 0;
  pointed = { x, y };
  answer.elements.answer.value = objects[next];
  choose(objects.length > 1 ? ` ${next + 1} of ${objects.length} here: click again for the next.` : "");
}

function markChosen() {
  const { value } = answer.elements.answer;
  for (const link of linksTo("object")) link.classList.toggle("chosen", link.dataset.object === value);
}

// Shows in the pictures and on the button which object is chosen in the form.
function choose(more = "") {
  const { value } = answer.elements.answer;
  markChosen();
  const label = answer.querySelector(`[for="object-${value}"]`).firstChild.textContent.trim();
  face(null); // so that Enter does not walk away from a choice
  answer.querySelector("button").textContent = value === "none" ? "Stop without an answer" : `Answer: ${label}`;
  say(`Chosen: ${label}.${more}`);
}

panorama.addEventListener("keydown", (event) => {
  if (event.altKey || event.ctrlKey || event.metaKey || event.target !== panorama) return;
  const numbered = panorama.querySelector(`a[data-way="${CSS.escape(event.key)}"]`);
  if (event.key === "ArrowLeft") turn(-1);
  else if (event.key === "ArrowRight") turn(1);
  else if (event.key === "Enter" && facing) go(facing);
  else if (numbered) go(numbered);
  else return;
  event.preventDefault();
});

for (const part of [ahead, panorama]) {
  part.addEventListener("mousedown", (event) => {
    if (!event.target.closest("a")) return;
    event.preventDefault(); // the focus stays in the panorama, where the keys work
    panorama.focus({ preventScroll: true });
  });
}

for (const part of [ahead, panorama, ways]) {
  part.addEventListener("click", (event) => {
    const link = event.target.closest("a");
    if (!link || event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    if (link.dataset.object) point(event);
    else if ("turn" in link.dataset) look(new URL(link.getAttribute("href"), location));
    else go(link);
  });
}
answer.addEventListener("change", () => choose());
addEventListener("popstate", () => show(location.href));
addEventListener("pageshow", () => { // choices that the browser restores
  if (answer.elements.answer.value) choose();
});

panorama.focus({ preventScroll: true });
faceAhead();
