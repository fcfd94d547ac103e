//! `dbbd acquire`: the bar's lengths into a capture.

pub(super) mod simulated;
mod view;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use indicatif::ProgressBar;

use super::{Outcome, Output, artefact, output, positive, protocols};
use crate::base::clock;
use crate::base::units::HostNs;
use crate::catalogue::{AxesFinding, CliFinding, PortFinding, ProtocolFinding};
use crate::daemon::{
    ALARM_SHARE, Acquisition, AxesSource, Ending, Lines, MountDetector, Options, Progress, Schedule, Server,
    Summary, stop_on_signal, zero,
};
use crate::device::axes::AxesAddress;
use crate::device::port::{self, PortAddress};
use crate::diagnostic::Diagnostic;
use crate::plan::DEFAULT_PROTOCOL;
use crate::provenance::Identity;
use crate::recording::axes::PacketCounts;
use crate::recording::run::{self, PlanFiles};

/// Pause between lines of progress where there is no terminal, s.
const LINE_EVERY_S: f64 = 5.0;

/// When a run ends; shown below the options.
const ENDS: &str = "The run ends at the program's end mark (two short strobe pulses after a dwell: with --plan the \
last circle's, without a plan after 20 s of device time with no strobe; with --ekrl and --plan: when the program has \
reported its last dwell and closed the channel), after --duration, on a signal (SIGINT, SIGTERM, SIGHUP, SIGQUIT, \
SIGUSR1, SIGUSR2; after `nohup` not on SIGHUP), \
or when the port stays away for --gone. Bytes are written before they are decoded: a kill loses at most the \
record being written, a loss of power what came since the last --sync-every. A disk that is full or fails ends \
the run: every whole record is kept (exit code 1). Exit code 3: samples, poses or time are missing, nothing was \
understood, or the capture was taken away and recording went on in a new file.";

/// Read the bar into a capture.
///
/// The capture holds the raw bytes, the samples, every gap and fault, the plan and the protocol in force, and
/// survives a kill. More: docs/reference/capture.md.
#[derive(clap::Args, Clone)]
#[command(after_help = ENDS)]
pub(crate) struct Args {
    /// Where the bar is: a serial port (/dev/ttyUSB0, COM3, by-id/NAME or by-path/NAME, see `dbbd ports`), a raw serial
    /// server as tcp://HOST:PORT, one whose line is set from here as rfc2217://HOST:PORT, or `sim`: a simulated cell that
    /// runs the plan, or without one the demo's.
    #[arg(long, value_name = "PORT")]
    port: PortAddress,
    /// Protocol of the bar: a built-in name or a TOML file [default: the plan's, else dbb-cobs-1].
    #[arg(long, value_name = "NAME|FILE")]
    protocol: Option<String>,
    /// Set a parameter of the protocol, as range_mm=50; `dbbd protocols show NAME` lists them.
    #[arg(long = "param", value_name = "NAME=VALUE", value_parser = protocols::param)]
    params: Vec<(String, String)>,
    /// Plan that the robot executes; it and the plan.json beside it go into the capture.
    #[arg(long, value_name = "PLAN.csv")]
    plan: Option<PathBuf>,
    /// Serial numbers, operator, laboratory, temperatures of this run, in place of those of the plan's job: a TOML file
    /// with the keys of its table [identity].
    #[arg(long, value_name = "FILE")]
    identity: Option<PathBuf>,
    /// Set the bar's present reading to zero before the run, where its protocol has a command for it.
    #[arg(long)]
    zero: bool,
    /// Listen here for a program written with `krl --sync ekrl --server ADDR:PORT`: it reports the begin and the end
    /// of each dwell with the axis angles it measured, over EthernetKRL (TCP). Addresses other than 127.0.0.1
    /// can be reached by others in that network.
    #[arg(long, value_name = "ADDR:PORT")]
    ekrl: Option<SocketAddr>,
    /// The controller's measured and commanded axes, recorded beside the bar's samples: rsi://ADDR:PORT listens here for
    /// KUKA RSI (UDP) and sends nothing, with ?answer=zero it answers each packet with a correction of zero, for a
    /// controller whose configuration waits for answers; rtde://HOST[:30004][?hz=125] asks a UR controller over RTDE (TCP).
    #[arg(long, value_name = "ADDRESS")]
    axes: Option<AxesAddress>,
    /// Capture to write; an existing file is not overwritten.
    #[arg(long, value_name = "RUN")]
    out: PathBuf,
    /// End after this many seconds of host time.
    #[arg(long, value_name = "S", value_parser = positive)]
    duration: Option<f64>,
    /// End when the port has been away for this many seconds (exit code 3; the run is kept).
    #[arg(long, value_name = "S", default_value = "10", value_parser = seconds)]
    gone: f64,
    /// How often the disk is made to hold what was written, s: what a loss of power costs at most.
    #[arg(long, value_name = "S", default_value = "1", value_parser = sync_seconds)]
    sync_every: f64,
}

/// A loss of power is not to cost more than an hour.
fn sync_seconds(text: &str) -> Result<f64, CliFinding> {
    const MOST_S: f64 = 3600.0;
    seconds(text).ok().filter(|s| *s <= MOST_S).ok_or(CliFinding::Outside {
        least: 0.0,
        most: MOST_S,
        unit: "s",
    })
}

fn seconds(text: &str) -> Result<f64, CliFinding> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(value),
        _ => Err(CliFinding::NotSeconds),
    }
}

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    let identity = args.identity.as_deref().map(artefact::identity).transpose()?.unwrap_or_default();
    let server = args.ekrl.map(Server::listen).transpose()?;
    if let Some(server) = &server {
        let address = server.address();
        out.progress(format!("listening for the program's telegrams on {address}"));
        if !address.ip().is_loopback() {
            out.finding(PortFinding::OpenToNetwork { address: address.to_string() });
        }
    }
    let axes = args.axes.as_ref().map(AxesSource::open).transpose()?;
    if let Some(axes) = &axes {
        out.progress(format!(
            "axes over {} at {}",
            args.axes.as_ref().map_or("", |at| at.protocol().name()),
            axes.address()
        ));
    }
    let lines = Lines { ekrl: server, axes };
    if args.port == PortAddress::Sim {
        let address = lines.ekrl.as_ref().map(Server::address);
        // A telegram has the host's time, so the simulation must keep to it.
        let speed = if address.is_some() { "1" } else { "0" };
        let cell = simulated::Cell::start(args.plan.as_deref(), speed, address, out)?;
        let args = Args { port: cell.port().clone(), plan: Some(cell.plan().into()), ..args.clone() };
        let summary = record(&args, identity, lines, out)?;
        // Of a run that was ended before, the simulator would wait for a reader.
        if matches!(summary.ending, Ending::Mark) {
            cell.finish()?;
        }
        out.document(&summary)?;
        return Ok(Outcome::Done);
    }
    out.document(&record(args, identity, lines, out)?)?;
    Ok(Outcome::Done)
}

impl Args {
    /// A bar read for so many seconds, without a plan.
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
            out,
            duration: Some(s),
            gone: 10.0,
            sync_every: 1.0,
        }
    }
}

/// What the capture says after `--zero`.
const ZEROED: &str = "the bar's reading was set to zero before the run";

/// Records until the run is over, and reports what it gave and what is to be doubted.
pub(super) fn record(
    args: &Args,
    identity: Identity,
    lines: Lines,
    out: &Output,
) -> Result<Summary, Diagnostic> {
    let plan = args.plan.as_deref().map(PlanFiles::read).transpose()?;
    if let Some(files) = &plan {
        let job = &files.plan.header.job;
        out.about(&artefact::other_run(&job.identity(), job.centres.len(), &identity));
    }
    let planned = plan.as_ref().map(|files| files.plan.header.job.bar.protocol.as_str());
    let name = args.protocol.as_deref().or(planned).unwrap_or(DEFAULT_PROTOCOL);
    let definition = protocols::load_with(name, &args.params)?;
    let schedule =
        plan.as_ref().map_or_else(Schedule::default, |files| Schedule::of(&files.plan, ALARM_SHARE));
    out.detail(format!("protocol {}: {}", definition.id, definition.title));
    if let Some(finding) = port::blur(&args.port) {
        out.finding(finding);
    }
    if args.zero {
        if definition.zero.is_empty() {
            return Err(ProtocolFinding::NoZeroCommand { id: definition.id }.into());
        }
        zero(&args.port, &definition)?;
        out.progress(ZEROED);
    }
    let stop = stop_on_signal()?;
    let options = Options {
        port: args.port.clone(),
        definition,
        out: args.out.clone(),
        plan,
        identity,
        duration_s: args.duration,
        gone_s: args.gone,
        feed: None,
        sync_s: args.sync_every,
    };
    let acquisition = Acquisition::start_with(lines, options, stop)?;
    if args.zero {
        acquisition.mark(ZEROED.into());
    }
    out.progress(format!("reading {} into {}", args.port, args.out.display()));
    show(&acquisition, &schedule, out)?;
    acquisition.findings().into_iter().for_each(|finding| out.finding(finding));
    let summary = acquisition.join()?;
    conclude(&summary, args, out)?;
    Ok(summary)
}

/// Shows how the run goes until it is over.
fn show(acquisition: &Acquisition, schedule: &Schedule, out: &Output) -> Result<(), Diagnostic> {
    let line = out.decorated().then(ProgressBar::new_spinner);
    if let Some(line) = &line {
        line.set_style(output::style("{spinner} {msg}"));
        line.enable_steady_tick(Duration::from_millis(200));
    }
    let mut said: Option<HostNs> = None;
    let mut mount = MountDetector::default();
    while !acquisition.is_over() {
        clock::sleep(0.05);
        acquisition.findings().into_iter().for_each(|finding| out.finding(finding));
        let progress = acquisition.progress();
        if let Some(line) = &line {
            line.set_message(view::lines(&progress, schedule, &mut mount));
        } else if said.is_none_or(|at| clock::now().seconds_since(at) >= LINE_EVERY_S) {
            if said.is_some() {
                out.progress(status(&progress));
            }
            said = Some(clock::now());
        }
    }
    if let Some(line) = line {
        line.finish_and_clear();
    }
    Ok(())
}

fn status(progress: &Progress) -> String {
    if progress.gone {
        return format!("{:.0} s: the port is gone, waiting for it", progress.elapsed_s);
    }
    let reading = progress.reading_mm.map_or("no reading yet".into(), |mm| format!("{mm:+.4} mm"));
    format!(
        "{:.0} s: {reading}, {:.0} Hz, {} dwells, {} bytes{}",
        progress.elapsed_s,
        progress.rate_hz,
        progress.dwells,
        progress.bytes,
        losses(progress)
    )
}

/// What was lost or spoiled so far; nothing where there is nothing.
fn losses(progress: &Progress) -> String {
    let counts = [
        (progress.gaps, "gaps"),
        (progress.missing, "samples missing"),
        (progress.faults, "faults"),
        (progress.unanswered, "requests unanswered"),
        (progress.lost_bytes, "bytes lost"),
        (progress.telegrams, "telegrams"),
        (progress.refused, "telegrams refused"),
    ];
    let found = counts.into_iter().filter(|(count, _)| *count > 0);
    let axes = progress.axes.map(|counts| format!("; axes: {}", output::packets(&counts)));
    found.map(|(count, what)| format!(", {count} {what}")).chain(axes).collect()
}

fn conclude(summary: &Summary, args: &Args, out: &Output) -> Result<(), Diagnostic> {
    let Summary { capture, ending, progress } = summary;
    out.result(format!(
        "{}: {} samples, {} dwells, {} bytes in {:.1} s; {}",
        capture.display(),
        progress.samples,
        progress.dwells,
        progress.bytes,
        progress.elapsed_s,
        ending.reason()
    ));
    doubts(summary, args).into_iter().for_each(|finding| out.finding(finding));
    axes_doubts(summary, args).into_iter().for_each(|finding| out.finding(finding));
    if args.plan.is_some() && progress.samples > 0 {
        run::losses(capture)?.into_iter().for_each(|loss| out.finding(loss));
    }
    Ok(())
}

fn doubts(summary: &Summary, args: &Args) -> Vec<PortFinding> {
    let Summary { ending, progress, .. } = *summary;
    let Progress { missing, lost_bytes, gaps, silent_s, .. } = progress;
    let doubts = [
        (ending == Ending::Gone, PortFinding::StayedAway { port: args.port.to_string(), gone_s: args.gone }),
        (progress.bytes == 0, PortFinding::NothingReceived),
        (progress.bytes > 0 && !progress.in_step && progress.rejected == 0, PortFinding::NotThisProtocol),
        (
            progress.samples == 0 && progress.rejected > 0,
            PortFinding::NoLength { refusals: progress.rejected },
        ),
        (
            progress.samples > 0 && progress.invalid == progress.samples,
            PortFinding::NoValid { samples: progress.samples },
        ),
        (silent_s > 0.0, PortFinding::FellSilent { silent_s, gaps }),
        (missing > 0 || lost_bytes > 0, PortFinding::SamplesMissing { missing, lost_bytes, gaps }),
        (progress.unanswered > 0, PortFinding::Unanswered { requests: progress.unanswered }),
        (progress.refused > 0, PortFinding::TelegramsRefused { telegrams: progress.refused }),
        (args.ekrl.is_some() && progress.telegrams == 0, PortFinding::NoTelegram),
    ];
    doubts.into_iter().filter_map(|(found, finding)| found.then_some(finding)).collect()
}

/// What is to be doubted of the controller's axes.
fn axes_doubts(summary: &Summary, args: &Args) -> Vec<AxesFinding> {
    let Some(address) = args.axes.as_ref().map(ToString::to_string) else { return Vec::new() };
    let counts = summary.progress.axes.unwrap_or_default();
    let PacketCounts { packets, used, lost, malformed, restarts, late_answers, .. } = counts;
    let none = if packets == malformed && packets > 0 {
        AxesFinding::NothingUnderstood { address, packets }
    } else {
        AxesFinding::NothingCame { address }
    };
    let doubts = [
        (used == 0, none),
        (lost + malformed > 0 && used > 0, AxesFinding::PacketsLost { lost, malformed, packets }),
        (restarts > 0, AxesFinding::ClockRestarted { restarts }),
        (late_answers > 0, AxesFinding::AnswersLate { late_answers }),
    ];
    doubts.into_iter().filter_map(|(found, finding)| found.then_some(finding)).collect()
}
