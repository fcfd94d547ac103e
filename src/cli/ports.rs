//! `dbbd ports`.

use super::{Outcome, Output};
use crate::catalogue::PortFinding;
use crate::device::port;
use crate::diagnostic::Diagnostic;

/// List the serial ports.
///
/// Prints the names by-id/.. and by-path/.. too, which remain when the device is plugged in again.
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
    let ports = port::list()?;
    out.list(&ports)?;
    if ports.is_empty() {
        out.finding(PortFinding::NoPorts);
    }
    for port in ports {
        let by_id = port.by_id.map_or(String::new(), |name| format!("  {name}"));
        out.result(format!("{}  {}{by_id}", port.port, port.description));
        if let Some(hold_ms @ 2..) = port.latency_ms {
            let device = port.port.trim_start_matches("/dev/").to_owned();
            out.finding(PortFinding::AdapterHoldsBack { device, hold_ms });
        }
    }
    Ok(Outcome::Done)
}
