#!/bin/sh
# Renews the script of the view in three dimensions: packs three from the npm registry, bundles what scene.js uses, minifies and
# compresses it. Needs node, npm and the registry. The versions are pinned: a change of them is a change of this file.
set -eu

three=0.187.0
esbuild=0.28.2

here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm init -y >/dev/null
npm install --no-audit --no-fund --silent "three@$three" "esbuild@$esbuild"
cp "$here/three.entry.js" entry.js
npx esbuild entry.js --bundle --minify --format=esm --target=es2022 --legal-comments=none \
    --banner:js="/* three $three, MIT, see vendor/three.LICENSE; made by vendor/renew.sh */" --outfile=three.js
# Without name and time, so that the same versions give the same bytes.
gzip -9 -n -c three.js >"$here/three.js.gz"
cp node_modules/three/LICENSE "$here/three.LICENSE"
ls -l three.js "$here/three.js.gz"
