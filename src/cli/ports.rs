//! `dbbd ports`.

use super::{Outcome, Output};
use crate::catalogue::PortFinding;
use crate::device::port;
use crate::diagnostic::Diagnostic;

/// List the serial ports.
///
/// With the names by-id/.. and by-path/.. that stay when the device is plugged in anew.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: Option<What>,
}

#[derive(clap::Subcommand)]
enum What {
    /// List the serial ports (the default).
    List,
}

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    match args.what {
        None | Some(What::List) => {}
    }
    let found = port::list()?;
    out.list(&found)?;
    if found.is_empty() {
        out.finding(PortFinding::NoPorts);
    }
    for port in found {
        let by_id = port.by_id.map_or(String::new(), |name| format!("  {name}"));
        out.result(format!("{}  {}{by_id}", port.port, port.description));
        if let Some(hold_ms @ 2..) = port.latency_ms {
            let device = port.port.trim_start_matches("/dev/").to_owned();
            out.finding(PortFinding::AdapterHoldsBack { device, hold_ms });
        }
    }
    Ok(Outcome::Done)
}
