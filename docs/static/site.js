// Wide code and tables scroll by themselves: let the keyboard reach them.
for (const wide of document.querySelectorAll("pre, .table-wrapper")) {
  wide.tabIndex = 0;
}

// Versions of the site (docs/extensions/versions.py): a menu, and a note on pages of other versions
// than the newest release. A version whose folder was taken from its site has no list, and no menu.
const folder = new URL(document.documentElement.dataset.content_root, location.href);
const list = document.createElement("script");
list.src = new URL("../versions.js", folder);
list.addEventListener("load", () => showVersions(window.siteVersions));
document.head.append(list);

function showVersions(pages) {
  const names = Object.keys(pages);
  const here = folder.pathname.split("/").at(-2);
  const newest = names.find((name) => name !== "latest");
  if (names.length > 1) {
    document.querySelector(".sidebar-brand").after(menu(pages, names, here));
  }
  if (newest && here !== newest) {
    document.querySelector("article").prepend(note(here, link(pages, newest)));
  }
}

function menu(pages, names, here) {
  const all = element("ul", "");
  for (const name of names) {
    const one = link(pages, name);
    if (name === here) {
      one.ariaCurrent = "page";
    }
    all.append(element("li", "", one));
  }
  return element("details", "versions", element("summary", "", `Version: ${here}`), all);
}

function note(here, newest) {
  const what = here === "latest" ? "the version in development" : `version ${here}`;
  const text = [`This page is about ${what}. The newest release is `, newest, "."];
  return element("aside", "admonition warning", element("p", "", ...text));
}

// Leads to the same page of a version, or to its first page if it has no such page.
function link(pages, name) {
  const page = location.href.replace(/[?#].*/, "").slice(folder.href.length);
  const one = element("a", "", name);
  one.href = new URL(`../${name}/${pages[name].includes(page) ? page : "index.html"}`, folder);
  return one;
}

function element(tag, className, ...content) {
  const made = document.createElement(tag);
  made.className = className;
  made.append(...content);
  return made;
}
