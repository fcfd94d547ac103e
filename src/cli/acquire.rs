//! `dbbd acquire`.

pub(super) mod simulated;
mod view;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use indicatif::ProgressBar;

use super::{CommandOutcome, CommandOutput, output, value};
use crate::daemon::{
    ALARM_SHARE, Acquisition, AcquisitionOptions, AcquisitionSummary, AxesSource, ControllerConnections,
    EkrlServer, EndReason, MountDetector, RunProgress, Schedule, stop_on_signal, zero_bar,
};
use crate::live::RunCounts;
use dbbd_device::axes::AxesAddress;
use dbbd_device::axes::AxesFinding;
use dbbd_device::clock;
use dbbd_device::port::PortFinding;
use dbbd_device::port::{self, PortAddress};
use dbbd_device::protocol::ProtocolFinding;
use dbbd_job::plan::DEFAULT_PROTOCOL;
use dbbd_job::recording::axes::PacketCounts;
use dbbd_job::recording::run::{self, PlanFiles};
use dbbd_job::request;
use dbbd_job::sim::SimulationFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::Identity;

/// The interval between lines of progress if stderr is not a terminal, s.
const LINE_EVERY_S: f64 = 5.0;

/// Printed below the options.
const ENDS: &str = "The run ends at the end mark of the program (two short strobe pulses after a dwell: with --plan after \
the last circle, without a plan after 20 s of device time without a strobe; with --ekrl and --plan, when the program has \
reported its last dwell and closed the channel), after --duration, on a signal (SIGINT, SIGTERM, SIGHUP, SIGQUIT, \
SIGUSR1, SIGUSR2; after `nohup` not on SIGHUP), or when the port stays away for --gone. Bytes are written before they are \
decoded: if the process is killed, at most the record being written is lost; if the power fails, what arrived since the \
last --sync-every. If the disk is full or fails, the run ends and every complete record is kept (exit code 1). Exit code \
3: samples, poses or time are missing, nothing was decoded, the capture was taken away and recording continued in a new \
file, or another program wrote into it.";

/// Record the readings of a bar in a capture.
///
/// The capture contains the raw bytes, the samples, every gap and fault, the plan and the protocol, and is readable even
/// after the process is killed. More: docs/reference/capture.md.
#[derive(clap::Args, Clone)]
#[command(after_help = ENDS)]
pub(crate) struct AcquireArgs {
    /// Address of the bar: a serial port (/dev/ttyUSB0, COM3, by-id/NAME or by-path/NAME, see `dbbd ports`), a raw serial
    /// server as tcp://HOST:PORT, a serial server with remote control of the line as rfc2217://HOST:PORT, or `sim`: a
    /// simulated cell that runs the plan, or without a plan that of the demo.
    #[arg(long, value_name = "PORT")]
    port: PortAddress,
    /// Protocol of the bar: a built-in name or a TOML file [default: the plan's, else dbb-cobs-1].
    #[arg(long, value_name = "NAME|FILE")]
    protocol: Option<String>,
    /// Set a parameter of the protocol, for example range_mm=50; `dbbd protocols show NAME` lists the parameters.
    #[arg(long = "param", value_name = "NAME=VALUE", value_parser = value::name_value)]
    params: Vec<(String, String)>,
    /// Plan that the robot executes; it and the plan.json beside it are copied into the capture.
    #[arg(long, value_name = "PLAN.csv")]
    plan: Option<PathBuf>,
    /// Serial numbers, operator, laboratory and temperatures of this run, in place of those of the plan's job: a TOML file
    /// with the keys of the table [identity].
    #[arg(long, value_name = "FILE")]
    identity: Option<PathBuf>,
    /// Set the bar's present reading to zero before the run; its protocol must have a command for it.
    #[arg(long)]
    zero: bool,
    /// Listen on this address for a program written with `krl --sync ekrl --server ADDR:PORT`. It reports begin and end
    /// of each dwell with the measured axis angles over EthernetKRL (TCP). Addresses other than 127.0.0.1 are open to
    /// others in that network.
    #[arg(long, value_name = "ADDR:PORT")]
    ekrl: Option<SocketAddr>,
    /// Record the controller's measured and commanded axes beside the bar's samples. rsi://ADDR:PORT listens on this address
    /// for KUKA RSI (UDP) and sends nothing; with ?answer=zero it answers each packet with a correction of zero, for a
    /// controller that is configured to wait for answers. rtde://HOST[:30004][?hz=125] asks a UR controller over RTDE (TCP).
    #[arg(long, value_name = "ADDRESS")]
    axes: Option<AxesAddress>,
    /// For the port `sim`: seed of the simulated noise and repeatability [default: 1].
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Capture to write; an existing file is not overwritten.
    #[arg(long, value_name = "RUN")]
    out: PathBuf,
    /// End after this many seconds of host time.
    #[arg(long, value_name = "S", value_parser = value::positive)]
    duration: Option<f64>,
    /// End when the port has been away for this many seconds (exit code 3; the run is kept).
    #[arg(long, value_name = "S", default_value = "10", value_parser = value::seconds)]
    gone: f64,
    /// Time from one flush of the data to the disk to the next, s, 0 to 3600. A loss of power loses at most this much, and
    /// what arrives while a slow disk flushes.
    #[arg(long, value_name = "S", default_value = "1", value_parser = value::sync_seconds)]
    sync_every: f64,
}

pub(crate) fn run(args: &AcquireArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let identity = args.identity.as_deref().map(request::read_identity).transpose()?.unwrap_or_default();
    let server = args.ekrl.map(EkrlServer::listen).transpose()?;
    if let Some(server) = &server {
        let address = server.address();
        out.progress(format!("listening for the program's telegrams on {address}"));
        if !address.ip().is_loopback() {
            out.finding(PortFinding::OpenToNetwork { address: address.to_string() });
        }
    }
    let axes = args.axes.as_ref().map(AxesSource::open).transpose()?;
    if let (Some(axes), Some(address)) = (&axes, &args.axes) {
        out.progress(format!("axes over {} at {}", address.protocol().name(), axes.address()));
    }
    let controller = ControllerConnections { ekrl: server, axes };
    if args.port != PortAddress::Sim && args.seed.is_some() {
        return Err(SimulationFinding::SeedWithoutSimulation.into());
    }
    if args.port == PortAddress::Sim {
        let address = controller.ekrl.as_ref().map(EkrlServer::address);
        // Telegrams are stamped with the host's time: the simulation must run in real time.
        let speed = if address.is_some() { "1" } else { "0" };
        let protocol = args.protocol.as_deref().map(|name| (name, args.params.as_slice()));
        let options = simulated::CellOptions {
            speed,
            halt_s: simulated::HALT_S,
            server: address,
            protocol,
            seed: args.seed,
        };
        let cell = simulated::PlanSimulator::start(args.plan.as_deref(), options, out)?;
        let args = AcquireArgs { port: cell.port().clone(), plan: Some(cell.plan().into()), ..args.clone() };
        let summary = record(&args, identity, controller, out)?;
        // If the run ended earlier, the simulator still waits for a reader.
        if matches!(summary.ending, EndReason::Mark) {
            cell.finish()?;
        }
        out.document(&summary)?;
        return Ok(CommandOutcome::Done);
    }
    out.document(&record(args, identity, controller, out)?)?;
    Ok(CommandOutcome::Done)
}

impl AcquireArgs {
    /// The arguments to record for so many seconds without a plan.
    pub(super) fn timed(
        port: PortAddress,
        protocol: String,
        params: Vec<(String, String)>,
        out: PathBuf,
        s: f64,
    ) -> Self {
        Self {
            port,
            protocol: Some(protocol),
            params,
            plan: None,
            identity: None,
            zero: false,
            ekrl: None,
            axes: None,
            seed: None,
            out,
            duration: Some(s),
            gone: 10.0,
            sync_every: 1.0,
        }
    }
}

/// The remark in the capture after `--zero`.
const ZEROED: &str = "the bar's reading was set to zero before the run";

/// Records until the run is over, and reports its result and its warnings.
pub(super) fn record(
    args: &AcquireArgs,
    identity: Identity,
    controller: ControllerConnections,
    out: &CommandOutput,
) -> Result<AcquisitionSummary, Diagnostic> {
    let plan = args.plan.as_deref().map(PlanFiles::read).transpose()?;
    if let Some(files) = &plan {
        let job = &files.plan.header.job;
        out.findings(request::other_run(&job.identity(), job.centres.len(), &identity));
    }
    let planned = plan.as_ref().map(|files| files.plan.header.job.bar.protocol.as_str());
    let name = args.protocol.as_deref().or(planned).unwrap_or(DEFAULT_PROTOCOL);
    let definition = request::read_protocol(name, &args.params)?;
    let schedule =
        plan.as_ref().map_or_else(Schedule::default, |files| Schedule::of(&files.plan, ALARM_SHARE));
    out.detail(format!("protocol {}: {}", definition.id, definition.title));
    out.findings(port::blur(&args.port));
    if args.zero {
        if definition.zero.is_empty() {
            return Err(ProtocolFinding::NoZeroCommand { id: definition.id }.into());
        }
        zero_bar(&args.port, &definition)?;
        out.progress(ZEROED);
    }
    let stop = stop_on_signal()?;
    let options = AcquisitionOptions {
        port: args.port.clone(),
        definition,
        out: args.out.clone(),
        plan,
        identity,
        controller,
        duration_s: args.duration,
        gone_s: args.gone,
        feed: None,
        sync_s: args.sync_every,
    };
    let acquisition = Acquisition::start(options, stop)?;
    if args.zero {
        // Of a run that is over already nothing is needed.
        _ = acquisition.mark(ZEROED.into());
    }
    out.progress(format!("reading {} into {}", args.port, args.out.display()));
    show_progress(&acquisition, &schedule, out);
    out.findings(acquisition.findings());
    let summary = acquisition.join()?;
    conclude(&summary, args, out)?;
    Ok(summary)
}

/// Shows the progress of the run until it is over.
fn show_progress(acquisition: &Acquisition, schedule: &Schedule, out: &CommandOutput) {
    let line = out.decorated().then(ProgressBar::new_spinner);
    if let Some(line) = &line {
        line.set_style(output::style("{spinner} {msg}"));
        line.enable_steady_tick(Duration::from_millis(200));
    }
    let mut last_line = clock::now();
    let mut mount = MountDetector::default();
    while !acquisition.is_over() {
        clock::sleep(0.05);
        out.findings(acquisition.findings());
        let progress = acquisition.progress();
        if let Some(line) = &line {
            line.set_message(view::progress_lines(&progress, schedule, &mut mount));
        } else if clock::now().seconds_since(last_line) >= LINE_EVERY_S {
            last_line = clock::now();
            out.progress(status(&progress));
        }
    }
    if let Some(line) = line {
        line.finish_and_clear();
    }
}

fn status(progress: &RunProgress) -> String {
    let counts = &progress.counts;
    if counts.gone {
        return format!("{:.0} s: the port is gone, waiting for it", counts.elapsed_s);
    }
    let reading = counts.reading_mm.map_or("no reading yet".into(), |mm| format!("{mm:+.4} mm"));
    format!(
        "{:.0} s: {reading}, {:.0} Hz, {} dwells, {} bytes{}",
        counts.elapsed_s,
        counts.rate_hz,
        counts.dwells,
        counts.bytes,
        losses(progress)
    )
}

/// What was lost or damaged so far, and the packets with axes.
fn losses(progress: &RunProgress) -> String {
    let counts = &progress.counts;
    let losses = output::nonzero([
        (counts.gaps, "gaps"),
        (counts.missing, "samples missing"),
        (counts.faults, "faults"),
        (counts.unanswered, "requests unanswered"),
        (counts.lost_bytes, "bytes lost"),
        (progress.telegrams, "telegrams"),
        (progress.refused, "telegrams refused"),
    ]);
    let axes = progress.axes.map(|packets| format!("; axes: {}", output::packets(&packets)));
    losses + &axes.unwrap_or_default()
}

fn conclude(summary: &AcquisitionSummary, args: &AcquireArgs, out: &CommandOutput) -> Result<(), Diagnostic> {
    let AcquisitionSummary { capture, ending, progress } = summary;
    let counts = &progress.counts;
    out.result(format!(
        "{}: {} samples, {} dwells, {} bytes in {:.1} s; {}",
        capture.display(),
        counts.samples,
        counts.dwells,
        counts.bytes,
        counts.elapsed_s,
        ending.reason()
    ));
    out.findings(run_warnings(summary, args));
    out.findings(axes_warnings(summary, args));
    // Another program may have written into the file: it is read back.
    out.findings_in(capture.display(), run::damages(capture)?);
    if args.plan.is_some() && counts.samples > 0 {
        out.findings(run::losses_at_end(capture, counts.samples, run::MAX_COMPARED)?);
    }
    Ok(())
}

fn run_warnings(summary: &AcquisitionSummary, args: &AcquireArgs) -> Vec<PortFinding> {
    /// A run has more than one valid reading in so many, also with long pauses without the bar.
    const FEW_IN: u64 = 100;
    let AcquisitionSummary { ending, progress, .. } = *summary;
    let RunCounts { missing, lost_bytes, gaps, .. } = progress.counts;
    let RunProgress { counts, silent_s, stood_still_s, other_unit, .. } = progress;
    let valid = counts.samples.saturating_sub(progress.invalid);
    let found = [
        (
            ending == EndReason::Gone,
            PortFinding::StayedAway { port: args.port.to_string(), gone_s: args.gone },
        ),
        (counts.bytes == 0, PortFinding::NothingReceived),
        (
            counts.bytes > 0 && !counts.in_step && counts.rejected == 0 && other_unit == 0,
            PortFinding::NotThisProtocol,
        ),
        (other_unit > 0, PortFinding::OtherUnit { readings: other_unit }),
        (counts.samples == 0 && counts.rejected > 0, PortFinding::NoLength { refusals: counts.rejected }),
        (counts.samples > FEW_IN * valid, PortFinding::FewValid { valid, samples: counts.samples }),
        (silent_s > 0.0, PortFinding::FellSilent { silent_s, gaps }),
        (stood_still_s > 0.0, PortFinding::StoodStill { seconds: stood_still_s, gaps }),
        (missing > 0 || lost_bytes > 0, PortFinding::SamplesMissing { missing, lost_bytes, gaps }),
        (counts.unanswered > 0, PortFinding::Unanswered { requests: counts.unanswered }),
        (progress.refused > 0, PortFinding::TelegramsRefused { telegrams: progress.refused }),
        (args.ekrl.is_some() && progress.telegrams == 0, PortFinding::NoTelegram),
    ];
    found.into_iter().filter_map(|(found, finding)| found.then_some(finding)).collect()
}

fn axes_warnings(summary: &AcquisitionSummary, args: &AcquireArgs) -> Vec<AxesFinding> {
    let Some(address) = args.axes.as_ref().map(ToString::to_string) else { return Vec::new() };
    let counts = summary.progress.axes.unwrap_or_default();
    let PacketCounts { packets, used, lost, malformed, restarts, late_answers, .. } = counts;
    let none = if packets == malformed && packets > 0 {
        AxesFinding::NothingUnderstood { address, packets }
    } else {
        AxesFinding::NothingCame { address }
    };
    let found = [
        (used == 0, none),
        (lost + malformed > 0 && used > 0, AxesFinding::PacketsLost { lost, malformed, packets }),
        (restarts > 0, AxesFinding::ClockRestarted { restarts }),
        (late_answers > 0, AxesFinding::AnswersLate { late_answers }),
    ];
    found.into_iter().filter_map(|(found, finding)| found.then_some(finding)).collect()
}
