//! `dbbd bar`.

use std::path::PathBuf;
use std::thread;

use serde::Serialize;

use super::child::LOOPBACK;
use super::{CommandOutcome, CommandOutput, acquire, value};
use crate::daemon::{ControllerConnections, ProbeAttempt, ProtocolSearch};
use dbbd_device::port::PortAddress;
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_job::file_set::{EarlierFiles, FileSet};
use dbbd_job::files;
use dbbd_job::plan::DEFAULT_PROTOCOL;
use dbbd_job::recording::BarFinding;
use dbbd_job::recording::StreamBuilder;
use dbbd_job::recording::bar_check::BarCheck;
use dbbd_job::recording::capture::{CaptureRecord, CaptureSummary};
use dbbd_job::report;
use dbbd_job::request;
use dbbd_job::sim::{self, bar::Terminal};
use dbbd_model::base::serialised;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::{Artefact, ArtefactRole, Identity};

/// Readings per second of the simulated bar.
const RATE_HZ: f64 = 1000.0;
/// The seed of its noise.
const SIMULATED_NOISE_SEED: u64 = 1;

/// Identify the protocol of a bar, or measure its noise.
#[derive(clap::Args)]
pub(crate) struct BarArgs {
    #[command(subcommand)]
    what: BarVerb,
}

#[derive(clap::Subcommand)]
enum BarVerb {
    Identify(BarIdentifyArgs),
    Check(BarCheckArgs),
}

/// Identify the protocol of a bar.
///
/// Listens at the baud rates of the built-in definitions. If the bar sends nothing by itself, asks it with the commands of
/// each definition (stop, init, start, poll of `dbbd protocols show`). Ranks the definitions by the share of the bytes that
/// they explain, and by how improbable as many readings are in the same bytes in random order. Exit code 3: the protocol is
/// unknown, or no bytes arrived.
#[derive(clap::Args)]
struct BarIdentifyArgs {
    /// Address of the bar, as for `dbbd acquire`.
    #[arg(long, value_name = "PORT")]
    port: PortAddress,
    /// How long to collect bytes in each attempt, s.
    #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = value::positive)]
    duration: f64,
    /// Only listen: send nothing to the device.
    #[arg(long)]
    listen: bool,
}

/// Measure the noise of a bar at rest.
///
/// Mount the bar between two balls that do not move. Measures noise, resolution, rate and drift, and the standard deviation
/// of a length at a dwell. Writes `bar.toml` (the section [bar] of a job), `bar.html` (plots), `bar.json` (numbers) and
/// `bar.dbbd` (the capture). Exit code 3: the bar was not at rest, drifts, or lost readings.
#[derive(clap::Args)]
struct BarCheckArgs {
    /// Address of the bar, as for `dbbd acquire`.
    #[arg(long, value_name = "PORT")]
    port: PortAddress,
    /// Protocol of the bar: a built-in name or a TOML file; `dbbd bar identify` finds it.
    #[arg(long, value_name = "NAME|FILE", default_value = DEFAULT_PROTOCOL)]
    protocol: String,
    /// Set a parameter of the protocol, for example range_mm=50; `dbbd protocols show NAME` lists the parameters.
    #[arg(long = "param", value_name = "NAME=VALUE", value_parser = value::name_value)]
    params: Vec<(String, String)>,
    /// How long to record, s.
    #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = value::positive)]
    duration: f64,
    /// Directory for bar.toml, bar.html, bar.json and the capture bar.dbbd, which must not exist yet.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// The JSON document of `bar identify`.
#[derive(Serialize)]
struct IdentifiedBar<'a> {
    port: String,
    /// The protocol, if the bytes identify it.
    protocol: Option<&'a str>,
    attempts: &'a [ProbeAttempt],
}

pub(crate) fn run(args: &BarArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    match &args.what {
        BarVerb::Identify(args) => identify(args, out),
        BarVerb::Check(args) => run_bar_check(args, out),
    }
}

/// The address of the bar. For `sim`, starts a virtual bar at rest between two balls.
fn bar_at(port: &PortAddress) -> Result<PortAddress, Diagnostic> {
    if *port != PortAddress::Sim {
        return Ok(port.clone());
    }
    let definition = request::read_protocol(DEFAULT_PROTOCOL, &[])?;
    let terminal = Terminal::listen(&LOOPBACK.parse()?)?;
    let address = terminal.address().clone();
    let options = sim::bar::VirtualBarOptions { rate_hz: RATE_HZ, speed: 1.0, first_ticks: 0 };
    // The thread ends with the process.
    thread::spawn(move || {
        sim::bar::serve_bar(terminal, &definition, options, sim::bar::at_rest(SIMULATED_NOISE_SEED))
    });
    Ok(address)
}

fn identify(args: &BarIdentifyArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let definitions: Vec<ProtocolDefinition> = ProtocolDefinition::built_in()
        .iter()
        .filter_map(|(name, _)| ProtocolDefinition::by_name(name))
        .collect::<Result<_, _>>()?;
    let port = bar_at(&args.port)?;
    let search =
        ProtocolSearch { port: &port, definitions: &definitions, span_s: args.duration, asks: !args.listen };
    let attempts = search.attempts(|attempt| out.progress(progress(attempt)))?;
    let last = attempts.iter().max_by_key(|attempt| (attempt.found().is_some(), attempt.bytes));
    let protocol = last.and_then(ProbeAttempt::found).map(|evidence| evidence.protocol.as_str());
    if protocol.is_none() {
        out.finding(match last.map_or(0, |attempt| attempt.bytes) {
            0 => BarFinding::SaysNothing { port: args.port.to_string() },
            bytes => BarFinding::UnknownDevice { bytes },
        });
    }
    for evidence in last.into_iter().flat_map(|attempt| &attempt.ranked) {
        out.result(format!(
            "{:<22} {:>6} readings, {:>3.0} % of the bytes explained, 2^-{:.0} by chance",
            evidence.protocol,
            evidence.samples,
            100.0 * evidence.explained,
            evidence.bits
        ));
    }
    if let Some(protocol) = protocol {
        out.result(format!("dbbd acquire --port {} --protocol {protocol} --out RUN", args.port));
    }
    out.document(&IdentifiedBar { port: args.port.to_string(), protocol, attempts: &attempts })?;
    Ok(CommandOutcome::Done)
}

fn progress(attempt: &ProbeAttempt) -> String {
    let baud = attempt.baud.map_or(String::new(), |baud| format!(" at {baud} baud"));
    let how = attempt.asked.as_ref().map_or("listened".to_owned(), |name| format!("asked as {name}"));
    format!("{how}{baud}: {} bytes", attempt.bytes)
}

fn run_bar_check(args: &BarCheckArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    files::directory(&args.out)?;
    let capture = args.out.join("bar.dbbd");
    let BarCheckArgs { protocol, params, duration, .. } = args;
    let port = bar_at(&args.port)?;
    let run = acquire::AcquireArgs::timed(port, protocol.clone(), params.clone(), capture.clone(), *duration);
    acquire::record(&run, Identity::default(), ControllerConnections::default(), out)?;
    let definition = request::read_protocol(protocol, params)?;
    let mut builder =
        StreamBuilder::new(definition.clock.map(Into::into)).sequence(definition.sequence_modulo);
    let pass = CaptureSummary::over(&capture, |stamped| {
        if let CaptureRecord::Samples(samples) = &stamped.record {
            samples.iter().for_each(|sample| builder.push(stamped.host, sample));
        }
        Ok(())
    })?;
    let check = BarCheck::of(&builder.build(), &definition)?;
    out.findings(check.findings.iter().cloned());
    let artefact =
        Artefact { origin: pass.origin, ..dbbd_job::artefact::of_file(ArtefactRole::Capture, &capture)? };
    let provenance = dbbd_job::artefact::made_from([&artefact.into()]);
    out.findings(provenance.of_origin());
    let mut set = FileSet::begin(&args.out, EarlierFiles::Keep)?;
    set.write("bar.toml", check.to_toml())?;
    set.write("bar.json", serialised::json(&check)? + "\n")?;
    set.write("bar.html", report::bar::html(&check, &provenance)?)?;
    set.finish()?;
    let um = |mm: f64| 1e3 * mm;
    out.result(format!(
        "sigma_um = {:.3}: one reading {:.3} um, resolution {:.3} um, {:.4} readings per second, drift {:+.3} um/min",
        um(check.sigma_mm),
        um(check.noise_mm),
        um(check.resolution_mm),
        check.rate_hz,
        um(check.drift_mm_min),
    ));
    out.result(args.out.join("bar.html").display().to_string());
    out.document(&check)?;
    Ok(CommandOutcome::Done)
}
