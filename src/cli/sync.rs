//! `dbbd sync`.

use std::path::PathBuf;

use serde_json::{Value, json};

use super::{Outcome, Output, Verdict};
use crate::files;
use crate::run;
use crate::sync::{Fate, Source, Stream, Synced};

/// Match the lengths of a capture to the commanded poses.
///
/// Lays the bar's clock on the host's, finds the dwells (or the passes of a program without stops) and matches them
/// to the plan. A pair is kept above 99 % of probability, else dropped and named with the reason. More:
/// docs/accuracy.md.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The capture.
    run: PathBuf,
    /// The plan that was driven, with its .json beside it [default: the one in the capture].
    #[arg(long, value_name = "PLAN.csv")]
    plan: Option<PathBuf>,
    /// The .dat of a module as fetched from the controller after the run: the axis angles that the program
    /// logged replace the commanded ones, as those do that it told over EthernetKRL. Once for each module.
    #[arg(long, value_name = "FILE.dat")]
    axes: Vec<PathBuf>,
    /// Where the observations go: lengths in mm, axis angles in degrees.
    #[arg(long, value_name = "OBS.csv")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, out: &Output) -> Verdict {
    let run = run::open(&args.run, args.plan.as_deref(), &args.axes, &mut |note| out.note(&note))?;
    let synced = run.timed();
    out.document(&document(&synced, &run.stream))?;
    show(&synced, out);
    out.result(format!("times: {}", times(&run.stream)));
    if synced.observations.rows.is_empty() {
        return Err("no dwell of the capture can be told to be a pose of the plan: nothing is written".into());
    }
    files::write(&args.out, synced.observations.to_csv())?;
    out.result(format!("{}: {} observations", args.out.display(), synced.observations.rows.len()));
    let doubt = run.torn || synced.warnings.iter().any(|warning| warning.doubt);
    Ok(if doubt { Outcome::Doubt } else { Outcome::Done })
}

fn source_word(source: Source) -> &'static str {
    match source {
        Source::Reports => "the controller's reports",
        Source::Strobe => "the strobe",
        Source::Stillness => "still stretches",
    }
}

/// On what clock the times stand, and how good they are.
fn times(stream: &Stream) -> String {
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

fn show(synced: &Synced, out: &Output) {
    let (matched, all) = (synced.observations.rows.len(), synced.fates.len());
    out.result(format!("{matched} of {all} poses have a length (dwells by {})", source_word(synced.source)));
    if let Some(factor) = synced.override_factor {
        out.result(format!("override: {:.1} %", 100.0 * factor));
    }
    for pose in &synced.fates {
        match &pose.fate {
            Fate::Matched { .. } => {}
            Fate::Missing { reason } => out.result(format!("  pose {}: none: {reason}", pose.index)),
            Fate::Ambiguous { reason } => out.result(format!("  pose {}: dropped: {reason}", pose.index)),
        }
    }
    if !synced.spurious.is_empty() {
        out.result(format!("{} stretches belong to no pose", synced.spurious.len()));
    }
    for lag in &synced.lags {
        let [lag_ms, sd_ms] = [lag.lag_s, lag.sd_s].map(|s| 1000.0 * s);
        out.result(format!(
            "circle {}: the reading comes {lag_ms:.1} +- {sd_ms:.1} ms after the command; the senses differ by {:.1} um",
            lag.circle,
            1000.0 * lag.hysteresis_mm
        ));
    }
    if let Some(drift) = synced.drift {
        let spread = drift.sd_mm.map_or(String::new(), |sd| format!(" +- {:.1}", 1000.0 * sd));
        let (um, readings) = (1000.0 * drift.change_mm, drift.readings);
        out.result(format!("drift at the reference pose: {um:.1}{spread} um over {readings} readings"));
    }
    out.matching(&synced.warnings);
}

fn document(synced: &Synced, stream: &Stream) -> Value {
    let poses: Vec<Value> = synced
        .fates
        .iter()
        .map(|pose| match &pose.fate {
            Fate::Matched { dwell, posterior } => json!({
                "index": pose.index, "fate": "matched", "posterior": posterior, "from_s": dwell.from_s,
                "to_s": dwell.to_s, "reading_mm": dwell.reading_mm, "u_mm": dwell.u_mm,
                "samples": dwell.samples, "invalid": dwell.invalid, "gaps": dwell.gaps,
                "creep_mm": dwell.creep_mm,
            }),
            Fate::Missing { reason } => json!({ "index": pose.index, "fate": "missing", "reason": reason }),
            Fate::Ambiguous { reason } => {
                json!({ "index": pose.index, "fate": "ambiguous", "reason": reason })
            }
        })
        .collect();
    let drift = synced.drift.map(|drift| {
        json!({
            "change_mm": drift.change_mm, "sd_mm": drift.sd_mm, "readings": drift.readings,
            "significant": drift.significant,
        })
    });
    let clock = stream.clock().map(|clock| {
        let breaks = clock.breaks.iter().map(|broken| {
            let t_s = stream.t_s.get(broken.at);
            json!({ "t_s": t_s, "reset": broken.reset, "jump_s": broken.jump_s, "host_s": broken.host_s })
        });
        json!({
            "drift_ppm": clock.drift().map(|drift| 1e6 * drift), "bound_s": clock.bound_s(),
            "wraps": clock.wraps, "breaks": breaks.collect::<Vec<_>>(),
        })
    });
    let lags: Vec<Value> = synced
        .lags
        .iter()
        .map(|lag| {
            json!({
                "circle": lag.circle, "lag_s": lag.lag_s, "sd_s": lag.sd_s, "hysteresis_mm": lag.hysteresis_mm,
            })
        })
        .collect();
    let warnings: Vec<Value> = synced
        .warnings
        .iter()
        .map(|warning| json!({ "kind": if warning.doubt { "doubt" } else { "note" }, "text": warning.text }))
        .collect();
    json!({
        "schema": 1, "poses": poses, "matched": synced.observations.rows.len(),
        "spurious": synced.spurious.len(), "source": source_word(synced.source),
        "override": synced.override_factor, "lags": lags, "drift": drift, "clock": clock,
        "warnings": warnings,
    })
}
