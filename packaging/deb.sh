#!/bin/sh
# Makes the Debian package in target/debian. Needs `cargo install cargo-deb`. With --no-build of target/release/dbbd as it is.
set -eu
cd "$(dirname "$0")/.."
# Whoever reads the program learns nothing of the machine that built it.
home=${CARGO_HOME:-$HOME/.cargo}
RUSTFLAGS="${RUSTFLAGS:-} --remap-path-prefix=$home=/cargo --remap-path-prefix=$PWD=/dbbd"
export RUSTFLAGS
[ "${1:-}" = --no-build ] || cargo build --release --locked --features archive,pdf
mkdir -p target/deb
dbbd=target/release/dbbd
$dbbd man > target/deb/dbbd.1
$dbbd completions bash > target/deb/dbbd
$dbbd completions zsh > target/deb/_dbbd
$dbbd completions fish > target/deb/dbbd.fish
cargo deb --no-build
