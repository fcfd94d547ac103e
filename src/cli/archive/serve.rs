//! `dbbd archive serve`.

use std::sync::Arc;

use crate::archive::{Addresses, PlantOptions, PlantPages};
use crate::cli::serve::Lines;
use crate::cli::{Outcome, Output};
use crate::daemon::{Door, serve_plant};
use crate::diagnostic::Diagnostic;

pub(super) fn run(
    addresses: Addresses,
    door: Door,
    options: PlantOptions,
    out: &Output,
) -> Result<Outcome, Diagnostic> {
    let pages = PlantPages::open(addresses, options)?;
    serve_plant(door, Arc::new(Lines { out: out.clone() }), Arc::new(pages))?;
    Ok(Outcome::Done)
}
