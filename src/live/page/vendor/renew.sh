#!/bin/sh
# Renews the scripts of others: packs them from the npm registry, bundles what the pages use of them, minifies and compresses it.
# three draws the view in three dimensions, uplot the plots. Needs node, npm and the registry. The versions are pinned: a change
# of them is a change of this file.
set -eu

three=0.187.0
uplot=1.6.32
esbuild=0.28.2

here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm init -y >/dev/null
npm install --no-audit --no-fund --silent "three@$three" "uplot@$uplot" "esbuild@$esbuild"
# Without name and time, so that the same versions give the same bytes.
bundle() {
    cp "$here/$1.entry.js" entry.js
    npx esbuild entry.js --bundle --minify --format=esm --target=es2022 --legal-comments=none \
        --banner:js="/* $1 $2, MIT, see vendor/$1.LICENSE; made by vendor/renew.sh */" --outfile="$1.js"
    gzip -9 -n -c "$1.js" >"$here/$1.js.gz"
    cp "node_modules/$1/LICENSE" "$here/$1.LICENSE"
    ls -l "$1.js" "$here/$1.js.gz"
}
bundle three "$three"
bundle uplot "$uplot"
{
    echo "/* uplot $uplot, MIT, see vendor/uplot.LICENSE; copied by vendor/renew.sh */"
    cat node_modules/uplot/dist/uPlot.min.css
} >"$here/uplot.css"
