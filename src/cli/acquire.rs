//! `dbbd acquire`.

use super::{Output, Verdict};

/// Arguments of the verb.
#[derive(clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args, _out: &Output) -> Verdict {
    Err("not there yet".into())
}
