//! Sets `DBBD_VERSION`: the version of the package and, in a release build from a git work tree, the commit.
//!
//! Other builds leave the commit out: it changes with every edit, and everything above this crate would be built again.

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

fn main() {
    let version = env!("CARGO_PKG_VERSION");
    let is_release = env::var_os("PROFILE").is_some_and(|profile| profile == "release");
    let commit = is_release.then(commit).flatten();
    let described = commit.map_or_else(|| version.to_owned(), |commit| format!("{version}+{commit}"));
    println!("cargo:rustc-env=DBBD_VERSION={described}");
    println!("cargo:rerun-if-changed=build.rs");
}

/// The commit, with `-dirty` if sources were changed since. `None` for a tarball, also inside another repository.
fn commit() -> Option<String> {
    // At run time: clones that share a target directory share this program.
    let here = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR")?).canonicalize().ok()?;
    let root = here.parent()?.parent()?;
    let top = Path::new(&git(&["rev-parse", "--show-toplevel"])?).canonicalize().ok()?;
    if top != root {
        return None;
    }
    for sources in ["Cargo.toml", "src", "crates", "robots", "protocols"] {
        println!("cargo:rerun-if-changed={}", root.join(sources).display());
    }
    for changing in ["HEAD", "logs/HEAD"] {
        let file = here.join(git(&["rev-parse", "--git-path", changing])?);
        if file.exists() {
            println!("cargo:rerun-if-changed={}", file.display());
        }
    }
    git(&["--no-optional-locks", "describe", "--always", "--dirty", "--exclude=*", "--abbrev=12"])
}

fn git(args: &[&str]) -> Option<String> {
    let output = Command::new("git").args(args).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    (output.status.success() && !text.trim().is_empty()).then(|| text.trim().to_owned())
}
