//! `dbbd ports`.

use super::{Outcome, Output, Verdict};
use crate::port;

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

pub(crate) fn run(args: &Args, out: &Output) -> Verdict {
    match args.what {
        None | Some(What::List) => {}
    }
    let found = port::list()?;
    out.document(&found)?;
    if found.is_empty() {
        out.progress("no serial port is plugged in");
    }
    for port in found {
        let by_id = port.by_id.map_or(String::new(), |name| format!("  {name}"));
        out.result(format!("{}  {}{by_id}", port.port, port.description));
        if let Some(ms @ 2..) = port.latency_ms {
            out.warning(format!(
                "{} holds bytes back for up to {ms} ms; as root: echo 1 > /sys/bus/usb-serial/devices/{}/latency_timer",
                port.port,
                port.port.trim_start_matches("/dev/")
            ));
        }
    }
    Ok(Outcome::Done)
}
