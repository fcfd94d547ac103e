#!/bin/sh
# Makes the Debian package in target/debian. Needs `cargo install cargo-deb`. With --no-build of target/release/dbbd as it is.
set -eu
cd "$(dirname "$0")/.."
[ "${1:-}" = --no-build ] || cargo build --release --locked
mkdir -p target/deb
dbbd=target/release/dbbd
$dbbd man > target/deb/dbbd.1
$dbbd completions bash > target/deb/dbbd
$dbbd completions zsh > target/deb/_dbbd
$dbbd completions fish > target/deb/dbbd.fish
cargo deb --no-build
