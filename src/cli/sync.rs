//! `dbbd sync`.

use std::path::PathBuf;

use serde_json::{Value, json};

use super::{CommandOutcome, CommandOutput, output};
use dbbd_job::files;
use dbbd_job::recording::SampleStream;
use dbbd_job::recording::axes::FollowingError;
use dbbd_job::recording::matching::MatchingFinding;
use dbbd_job::recording::matching::{
    self, AxesReport, BarLag, DwellSource, MatchOutcome, PassLag, PoseMatching, PoseOutcome,
};
use dbbd_job::recording::run;
use dbbd_job::request::RequestWatch as _;
use dbbd_model::diagnostic::{Diagnostic, Finding};
use dbbd_model::provenance::{ArtefactRole, ProvenanceFinding};

/// Match the lengths of a capture to the commanded poses.
///
/// Synchronises the bar's clock with that of the host, detects the dwells (or the passes of a program without stops), and
/// matches them to the plan. A pair is kept if its probability exceeds 99 %, else dropped and listed with the reason. More:
/// docs/explanation/pose-matching.md.
#[derive(clap::Args)]
pub(crate) struct SyncArgs {
    /// The capture.
    run: PathBuf,
    /// The plan that the robot executed, with its .json beside it [default: the one in the capture].
    #[arg(long, value_name = "PLAN.csv")]
    plan: Option<PathBuf>,
    /// The .dat of a module, fetched from the controller after the run: the axis angles that the program logged replace the
    /// commanded ones, as do those that it sent over EthernetKRL. Give it once for each module.
    #[arg(long, value_name = "FILE.dat")]
    axes: Vec<PathBuf>,
    /// Table of measurements to write: lengths in mm, axis angles in degrees.
    #[arg(long, value_name = "OBS.csv")]
    out: PathBuf,
}

pub(crate) fn run(args: &SyncArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    files::keeps(&args.out, args.axes.iter().chain(&args.plan).chain([&args.run]).map(PathBuf::as_path))?;
    files::is_earlier(&args.out, b"index,centre,")?;
    let run =
        run::open_run(&args.run, args.plan.as_deref(), &args.axes, &mut |finding| out.finding(finding))?;
    out.done(40);
    let matching = run.matching(None)?;
    out.done(90);
    out.findings(matching.findings.iter().cloned());
    out.document(&document(&matching, &run.stream))?;
    show_matching(&matching, out);
    out.result(format!("times: {}", times(&run.stream)));
    if matching.observations.rows.is_empty() {
        let finding = matching::nothing_matched(&run.plan, &run.stream);
        return Err(Diagnostic::file(args.run.display(), finding));
    }
    let mut provenance = dbbd_job::artefact::made_from([&run.traced(&args.run)?]);
    for path in &args.axes {
        provenance.add(&dbbd_job::artefact::of_file(ArtefactRole::Program, path)?);
    }
    let table = matching.observations.to_csv();
    if let Some(aside) = dbbd_job::artefact::move_edited_aside(&args.out)? {
        let (table, aside) = (args.out.display().to_string(), aside.display().to_string());
        out.finding(ProvenanceFinding::EditedMovedAside { table, aside });
    }
    dbbd_job::artefact::write_beside(&provenance, &args.out, &table)?;
    files::write_file(&args.out, table)?;
    out.result(format!("{}: {} observations", args.out.display(), matching.observations.rows.len()));
    Ok(CommandOutcome::Done)
}

fn source_word(source: DwellSource) -> &'static str {
    match source {
        DwellSource::Reports => "the controller's reports",
        DwellSource::Strobe => "the strobe",
        DwellSource::Axes => "the published axes",
        DwellSource::Stillness => "still intervals",
    }
}

/// The clock of the times, and its accuracy.
fn times(stream: &SampleStream) -> String {
    let Some(clock) = stream.clock() else { return "the host's stamps at arrival or request".into() };
    let wraps = if clock.wraps > 0 { format!("; it wrapped {} times", clock.wraps) } else { String::new() };
    let Some((drift, bound_s)) = clock.drift().zip(clock.bound_s()) else {
        return format!("the bar's clock alone, which did not run at the host's pace{wraps}");
    };
    let (ppm, ms) = (1e6 * drift, 1e3 * bound_s);
    format!(
        "the bar's clock, {ppm:+.1} ppm to the host's, at most {ms:.2} ms off beyond the line's least delay{wraps}"
    )
}

fn show_matching(matching: &PoseMatching, out: &CommandOutput) {
    let (matched, all) = (matching.observations.rows.len(), matching.outcomes.len());
    let source = source_word(matching.source);
    out.result(format!("{matched} of {all} poses have a length (dwells by {source})"));
    if let Some(factor) = matching.override_factor {
        out.result(format!("override: {:.1} %", 100.0 * factor));
    }
    for PoseOutcome { index, outcome } in &matching.outcomes {
        match outcome {
            MatchOutcome::Matched { .. } => {}
            MatchOutcome::Missing { reason } => out.result(format!("  pose {index}: none: {reason}")),
            MatchOutcome::Ambiguous { reason } => out.result(format!("  pose {index}: dropped: {reason}")),
        }
    }
    if !matching.spurious.is_empty() {
        out.result(format!("{} detected dwells match no pose", matching.spurious.len()));
    }
    for PassLag { circle, lag_s, sd_s, hysteresis_mm } in &matching.lags {
        let [lag_ms, sd_ms] = [lag_s, sd_s].map(|s| 1000.0 * s);
        out.result(format!(
            "circle {circle}: the reading comes {lag_ms:.1} ms (u {sd_ms:.1}) after the command; the senses differ by {:.1} um",
            1000.0 * hysteresis_mm
        ));
    }
    if let Some(axes) = &matching.axes {
        show_axes(axes, out);
    }
    if let Some(drift) = matching.drift {
        let spread = drift.sd_mm.map_or(String::new(), |sd| format!(" (u {:.1})", 1000.0 * sd));
        let (um, readings) = (1000.0 * drift.change_mm, drift.readings);
        out.result(format!("drift at the reference pose: {um:.1} um{spread} over {readings} readings"));
    }
}

fn show_axes(axes: &AxesReport, out: &CommandOutput) {
    out.result(format!("axes over {}: {}", axes.protocol, output::packets(&axes.packets)));
    if let Some(BarLag { lag_s, sd_s, windows }) = axes.lag {
        let [lag_ms, sd_ms] = [lag_s, sd_s].map(|s| 1000.0 * s);
        out.result(format!(
            "the reading comes {lag_ms:.2} ms (u {sd_ms:.2}) after the axes ({windows} windows of motion)"
        ));
    }
    for FollowingError { axis, lag_s, moving_rms_deg, moving_max_deg, rest_max_deg, settling_s } in
        axes.following.iter().flatten()
    {
        let settling = settling_s.map_or(String::new(), |s| format!(", settles in {:.0} ms", 1000.0 * s));
        out.result(format!(
            "  axis {axis}: {:.1} ms behind its command, {moving_rms_deg:.4} degrees rms in motion (at most \
             {moving_max_deg:.4}), at most {rest_max_deg:.4} at rest{settling}",
            1000.0 * lag_s
        ));
    }
    if axes.pairs > 0 {
        let AxesReport { pairs, effective_pairs, .. } = axes;
        out.result(format!(
            "{pairs} pairs of axes and length in motion, worth {effective_pairs:.0} independent ones"
        ));
    }
}

fn axes_document(axes: &AxesReport) -> Value {
    json!({
        "protocol": axes.protocol, "packets": axes.packets, "drift_ppm": axes.drift.map(|drift| 1e6 * drift),
        "bound_s": axes.bound_s, "lag": axes.lag, "following": axes.following, "rests": axes.rests,
        "measured": axes.measured, "pairs": axes.pairs, "effective_pairs": axes.effective_pairs,
    })
}

fn document(matching: &PoseMatching, stream: &SampleStream) -> Value {
    let poses: Vec<Value> = matching.outcomes.iter().map(pose_document).collect();
    let drift = matching.drift.map(|drift| {
        json!({
            "change_mm": drift.change_mm, "sd_mm": drift.sd_mm, "readings": drift.readings,
            "significant": drift.significant,
        })
    });
    let lag = |lag: &PassLag| {
        json!({
            "circle": lag.circle, "lag_s": lag.lag_s, "sd_s": lag.sd_s, "hysteresis_mm": lag.hysteresis_mm,
        })
    };
    json!({
        "schema": 1, "poses": poses, "matched": matching.observations.rows.len(),
        "spurious": matching.spurious.len(), "source": source_word(matching.source),
        "override": matching.override_factor,
        "lags": matching.lags.iter().map(lag).collect::<Vec<_>>(), "drift": drift,
        "clock": clock_document(stream), "axes": matching.axes.as_ref().map(axes_document),
    })
}

fn pose_document(PoseOutcome { index, outcome }: &PoseOutcome) -> Value {
    let without = |word: &str, reason: &MatchingFinding| json!({ "index": index, "outcome": word, "code": reason.code(), "reason": reason.to_string() });
    match outcome {
        MatchOutcome::Matched { reading, posterior } => json!({
            "index": index, "outcome": "matched", "posterior": posterior, "from_s": reading.from_s,
            "to_s": reading.to_s, "reading_mm": reading.reading_mm, "u_mm": reading.u_mm,
            "samples": reading.samples, "invalid": reading.invalid, "gaps": reading.gaps,
            "creep_mm": reading.creep_mm,
        }),
        MatchOutcome::Missing { reason } => without("missing", reason),
        MatchOutcome::Ambiguous { reason } => without("ambiguous", reason),
    }
}

fn clock_document(stream: &SampleStream) -> Option<Value> {
    let clock = stream.clock()?;
    let breaks = clock.breaks.iter().map(|broken| {
        let t_s = stream.t_s.get(broken.at);
        json!({ "t_s": t_s, "reset": broken.reset, "jump_s": broken.jump_s, "host_s": broken.host_s })
    });
    Some(json!({
        "drift_ppm": clock.drift().map(|drift| 1e6 * drift), "bound_s": clock.bound_s(),
        "wraps": clock.wraps, "breaks": breaks.collect::<Vec<_>>(),
    }))
}
