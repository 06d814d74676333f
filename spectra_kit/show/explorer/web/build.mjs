// Bundles src/ and three.js into ../assets/explorer.js, which is committed: users need no Node.
// The second line of the bundle names the sources it was made from; a Python test compares.

import { createHash } from "node:crypto";
import { readFileSync, readdirSync } from "node:fs";
import { build } from "esbuild";

const here = new URL("./", import.meta.url);
const sources = [
  "build.mjs",
  "package-lock.json",
  ...readdirSync(new URL("src/", here)).filter((name) => name.endsWith(".js")).sort().map((name) => `src/${name}`),
];
const hash = createHash("sha256");
for (const name of sources) hash.update(readFileSync(new URL(name, here)));

const licence = readFileSync(new URL("node_modules/three/LICENSE", here), "utf8").trim();
await build({
  absWorkingDir: here.pathname,
  entryPoints: ["src/main.js"],
  outfile: "../assets/explorer.js",
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2022",
  charset: "utf8",
  legalComments: "none",
  banner: {
    js: `/* Built from spectra_kit/explorer/web: do not edit.\nsources sha256: ${hash.digest("hex")}\n\nContains three.js (https://threejs.org):\n\n${licence}\n*/`,
  },
});
