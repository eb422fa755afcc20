// How the site's search ranks pages: guides first, and those whose title has the words.
const field = document.querySelector('input[name="q"]');
const folders = {
  "reference/python/": -12,
  "reference/schemas": -12,
  "how-to/organising/": 0,
  "tutorials/": 4,
  "how-to/": 4,
  "explanation/": 3,
  "reference/": 2,
};

function split(text) {
  return text.toLowerCase().match(/\w{2,}/g) ?? [];
}

// Whether two words may be forms of one: protocol, protocols.
function isForm(one, other) {
  return one.startsWith(other) || other.startsWith(one);
}

var Scorer = {
  score: ([page, title, , , score]) => {
    const words = split(field.value);
    const [, bonus] = Object.entries(folders).find(([folder]) => page.startsWith(folder)) ?? ["", 0];
    const inTitle = words.filter((word) => split(title).some((other) => isForm(word, other))).length;
    return score + bonus + (10 * inTitle) / Math.max(1, words.length) - (page.endsWith("index") ? 8 : 0);
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
