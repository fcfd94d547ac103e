//! `dbbd ports`.

use super::{CommandOutcome, CommandOutput};
use dbbd_device::port;
use dbbd_device::port::PortFinding;
use dbbd_model::diagnostic::Diagnostic;

/// List the serial ports.
///
/// Prints the names by-id/.. and by-path/.. too, which remain when the device is plugged in again.
#[derive(clap::Args)]
pub(crate) struct PortsArgs {
    #[command(subcommand)]
    what: Option<PortsVerb>,
}

#[derive(clap::Subcommand)]
enum PortsVerb {
    /// List the serial ports (the default).
    List,
}

pub(crate) fn run(args: &PortsArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    match args.what {
        None | Some(PortsVerb::List) => {}
    }
    let ports = port::list_ports()?;
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
    Ok(CommandOutcome::Done)
}
