// Writes chart.min.js and its licences into the Python package, from what package-lock.json pins.
import { readFileSync, writeFileSync } from "node:fs";
import { build } from "esbuild";

const OUTPUT = new URL("../reverie_eval/server/http/static/vendor/", import.meta.url);
const BUNDLED = ["chart.js", "@kurkle/color"];

const read = (path) => readFileSync(new URL(path, import.meta.url), "utf8");
const lock = JSON.parse(read("package-lock.json")).packages;
const origins = BUNDLED.map((name) => {
  const { version, license, integrity } = lock[`node_modules/${name}`];
  return `${name} ${version} (npm), ${license}\n${integrity}`;
});

await build({
  entryPoints: [new URL("chart.js", import.meta.url).pathname],
  outfile: new URL("chart.min.js", OUTPUT).pathname,
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2022",
  legalComments: "none",
  banner: { js: `/*! Parts of these packages, built in web/; licences: chart.LICENSE.md\n${origins.join("\n")} */` },
});
const licences = BUNDLED.map((name, place) => `${origins[place]}\n\n${read(`node_modules/${name}/LICENSE.md`).trim()}\n`);
writeFileSync(new URL("chart.LICENSE.md", OUTPUT), licences.join("\n---\n\n"));
