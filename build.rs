//! Sets `DBBD_VERSION`: the version of the package, and the commit if this directory is the top of a git work tree.

use std::env;
use std::path::Path;
use std::process::Command;

fn main() {
    let version = env!("CARGO_PKG_VERSION");
    let described = commit().map_or_else(|| version.to_owned(), |commit| format!("{version}+{commit}"));
    println!("cargo:rustc-env=DBBD_VERSION={described}");
    for sources in ["build.rs", "Cargo.toml", "src", "robots", "protocols"] {
        println!("cargo:rerun-if-changed={sources}");
    }
}

/// The commit, with `-dirty` if sources were changed since. `None` for a tarball, also inside another repository.
fn commit() -> Option<String> {
    // At run time: clones that share a target directory share this program.
    let here = Path::new(&env::var_os("CARGO_MANIFEST_DIR")?).canonicalize().ok()?;
    let top = Path::new(&git(&["rev-parse", "--show-toplevel"])?).canonicalize().ok()?;
    if top != here {
        return None;
    }
    for changing in ["HEAD", "logs/HEAD"] {
        let file = git(&["rev-parse", "--git-path", changing])?;
        if Path::new(&file).exists() {
            println!("cargo:rerun-if-changed={file}");
        }
    }
    git(&["--no-optional-locks", "describe", "--always", "--dirty", "--exclude=*", "--abbrev=12"])
}

fn git(args: &[&str]) -> Option<String> {
    let output = Command::new("git").args(args).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    (output.status.success() && !text.trim().is_empty()).then(|| text.trim().to_owned())
}
