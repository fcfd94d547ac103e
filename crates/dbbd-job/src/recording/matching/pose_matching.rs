//! The result of a matching, and the findings that it shows about the run: lost poses, drift of the reference pose, a
//! frozen reading, other axes than commanded.

use std::ops::Range;

use super::input::MatchingInput;
use super::outcome::{DwellSource, MatchOutcome, PoseOutcome};
use super::passes::PassLag;
use super::published::AxesReport;
use crate::plan::timing::MIN_CODED_DWELLS;
use crate::plan::{Plan, PlanRow, PoseKind};
use crate::recording::dwell::{Dwell, DwellReading};
use crate::recording::matching::MatchingFinding as Finding;
use crate::recording::stream::SampleStream;
use dbbd_model::math::distributions::two_sided_tail;
use dbbd_model::math::robust::median;
use dbbd_model::math::straight_line::RegressionLine;
use dbbd_model::measurement::Measurements;

#[derive(Clone, Debug, PartialEq)]
pub struct PoseMatching {
    /// Lengths with the axis angles at which they were read, in the plan's order. The columns beyond the required
    /// ones are `kind,t_s,samples,creep,circle,angle_deg`: `creep` is 1 if the reading drifted within the dwell;
    /// `circle` and `angle_deg` are empty for a pose of no circle.
    ///
    /// `sigma_mm` is the standard uncertainty of the mean of the dwell, at least the bar's. It does not contain the
    /// robot's repeatability, which only the residuals of an identification show.
    pub observations: Measurements,
    /// One outcome for each dwell of the plan, in order.
    pub outcomes: Vec<PoseOutcome>,
    pub spurious: Vec<Dwell>,
    pub source: DwellSource,
    /// Speed override of the moves, 0..1, if it was estimated.
    pub override_factor: Option<f64>,
    /// Lag of the reading behind the command, for each continuous circle that shows it.
    pub lags: Vec<PassLag>,
    /// Drift of the length at the reference pose, if it was read twice or more.
    pub drift: Option<LengthDrift>,
    /// The odds that the program that ran is the program of this plan.
    pub code: CodeOdds,
    /// Results from the published axes, if they were used.
    pub axes: Option<AxesReport>,
    pub findings: Vec<Finding>,
}

impl PoseMatching {
    /// Whether both results match the same dwells to the same poses.
    pub fn same_pairs(&self, other: &Self) -> bool {
        let pair = |pose: &PoseOutcome| pose.reading().map(|reading| (reading.from_s, reading.to_s));
        self.outcomes.iter().map(pair).eq(other.outcomes.iter().map(pair))
    }
}

/// The odds that the intervals between the dwells follow this plan's time code, against the time code of another plan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CodeOdds {
    pub by_module: Vec<ModuleOdds>,
}

/// The odds of the dwells of a module.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ModuleOdds {
    /// Natural logarithm of the odds of this plan's code against another one.
    pub log_odds: f64,
    /// Number of commanded dwells (0 if the module alone shows nothing), and number of matched dwells.
    pub dwells: usize,
    pub matched: usize,
}

impl ModuleOdds {
    /// Least odds for each interval. An interval between matched dwells of this plan's program makes its code about six
    /// times as likely as another code, an interval of another plan's program at most 1.8 times (`cargo test
    /// foreign_programs`).
    const LEAST_OF_AN_INTERVAL: f64 = 2.0;
    /// A module with odds below this counts as a module of another plan, whatever was matched. If hardly anything was
    /// detected, the odds are about 1.
    const FOREIGN: f64 = 0.2;

    fn is_foreign(self) -> bool {
        let intervals = self.matched.saturating_sub(1);
        let asked = (intervals as f64 * Self::LEAST_OF_AN_INTERVAL.ln()).min(CodeOdds::OWN.ln());
        let too_low = intervals > 0 && self.log_odds < asked;
        too_low || self.log_odds < Self::FOREIGN.ln()
    }
}

impl CodeOdds {
    /// The odds at which a program counts as this plan's: a program of another plan reaches them once in a million
    /// runs.
    const OWN: f64 = 1e6;

    /// The first module (from 1) that was run by a program of another plan. A module with fewer dwells than are needed
    /// to show a plan counts only together with the others.
    pub fn foreign_module(&self) -> Option<usize> {
        let suffices = |module: &ModuleOdds| module.dwells >= MIN_CODED_DWELLS;
        let alone = self.by_module.iter().position(|module| suffices(module) && module.is_foreign());
        let all = self.by_module.iter().fold(ModuleOdds::default(), |all, module| ModuleOdds {
            log_odds: all.log_odds + module.log_odds,
            dwells: all.dwells + module.dwells,
            matched: all.matched + module.matched,
        });
        let least = |all: ModuleOdds| {
            let odds = self.by_module.iter().map(|module| module.log_odds).enumerate();
            odds.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(at, _)| at).filter(|_| all.is_foreign())
        };
        alone.or_else(|| least(all)).map(|at| at + 1)
    }

    /// Whether all dwells together show that the program is this plan's.
    pub fn is_own(&self) -> bool {
        self.by_module.iter().map(|module| module.log_odds).sum::<f64>() >= Self::OWN.ln()
    }
}

/// Change of the length at the reference pose over the run, from a line through its readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LengthDrift {
    /// Change from the first reading to the last, mm.
    pub change_mm: f64,
    /// Standard deviation from the scatter of the readings about the line, mm; `None` for two readings.
    pub sd_mm: Option<f64>,
    pub readings: usize,
    /// Whether the change is significant (95 %, of all repeated poses together) and exceeds the bar's standard deviation.
    pub significant: bool,
}

impl LengthDrift {
    /// Probability that a length without drift changes by as much; 1 where there is no standard deviation.
    fn by_chance(&self) -> f64 {
        let tail = |sd_mm: f64| two_sided_tail(self.change_mm / sd_mm, Some(self.readings as f64 - 2.0));
        self.sd_mm.map_or(1.0, tail)
    }
}

/// The reason why no pose was matched, as far as the stream shows it.
pub fn nothing_matched(plan: &Plan, stream: &SampleStream) -> Finding {
    /// Least range of the reading while a robot moves the bar, mm.
    const STILL_MM: f64 = 0.005;
    /// Longest run as a multiple of the duration of its program.
    const MAX_RUN_DURATION_RATIO: f64 = 50.0;
    let valid = (0..stream.len()).filter(|at| stream.valid(*at)).map(|at| stream.reading_mm[at]);
    let [low, high] = valid.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], reading| {
        [low.min(reading), high.max(reading)]
    });
    let (seconds, planned_s) = (stream.t_s.last().copied().unwrap_or(0.0), plan.duration_s());
    if low > high {
        Finding::NothingValid
    } else if high - low < STILL_MM {
        Finding::NothingMoves { reading_mm: low }
    } else if !(plan.least_duration_s()..=MAX_RUN_DURATION_RATIO * planned_s).contains(&seconds) {
        Finding::OtherDuration { seconds, planned_s }
    } else {
        Finding::NothingMatched
    }
}

fn percent(part: usize, all: usize) -> f64 {
    100.0 * part as f64 / all as f64
}

pub(super) fn run_findings(matching: &PoseMatching, input: &MatchingInput<'_>) -> Vec<Finding> {
    let (mut findings, stream) = (Vec::new(), input.stream);
    let poses = matching.outcomes.len();
    let readings = || matching.outcomes.iter().filter_map(PoseOutcome::reading);
    let matched = readings().count();
    let is_ambiguous = |pose: &&PoseOutcome| matches!(pose.outcome, MatchOutcome::Ambiguous { .. });
    let ambiguous = matching.outcomes.iter().filter(is_ambiguous).count();
    if ambiguous > 0 {
        let percent = percent(ambiguous, poses);
        findings.push(Finding::AmbiguousPoses { poses: ambiguous, percent });
    }
    let lost = poses - matched - ambiguous;
    if lost > 0 {
        findings.push(Finding::PosesLost { lost, poses, percent: percent(lost, poses) });
    }
    let dwells = readings().count();
    if !input.plan.identifies_its_poses() {
        findings.push(Finding::CodeOfEarlierVersion);
    } else if dwells > 0 && !matching.code.by_module.is_empty() && !matching.code.is_own() {
        findings.push(Finding::PlanNotShown { dwells });
    }
    let touched = || readings().filter(|reading| reading.invalid > 0);
    let invalid: usize = touched().map(|reading| reading.invalid).sum();
    if invalid > 0 {
        let samples = touched().map(|reading| reading.samples + reading.invalid).sum();
        let (percent, dwells) = (percent(invalid, samples), touched().count());
        findings.push(Finding::InvalidInDwells { invalid, samples, percent, dwells });
    }
    let creep = readings().filter(|reading| reading.creep_mm.is_some()).count();
    if creep > 0 {
        findings.push(Finding::Creep { dwells: creep });
    }
    let gaps = readings().filter(|reading| reading.gaps > 0).count();
    if gaps > 0 {
        findings.push(Finding::MissingSamples { dwells: gaps });
    }
    for broken in stream.clock().into_iter().flat_map(|clock| &clock.breaks) {
        let at_s = stream.t_s.get(broken.at).copied().unwrap_or(0.0);
        let (jump_s, host_s) = (broken.jump_s, broken.host_s);
        findings.push(if broken.reset {
            Finding::ClockRestarted { at_s, jump_s, host_s }
        } else {
            Finding::ClockJumped { at_s, jump_s, host_s }
        });
    }
    if let Some(drift) = matching.drift.filter(|drift| drift.significant) {
        findings.push(Finding::ReferenceDrift { change_um: 1000.0 * drift.change_mm });
    }
    findings
}

/// The finding if the measured axes differ from the commanded axes: everywhere by a little in absolute-accuracy mode,
/// or at single poses or by far if something is wrong.
pub(super) fn axes_deviation(matching: &PoseMatching, plan: &Plan) -> Option<Finding> {
    /// Largest deviation of a controller in position, degrees.
    const IN_POSITION_DEG: f64 = 0.05;
    /// Largest correction in absolute-accuracy mode at most poses, degrees.
    const CORRECTED_DEG: f64 = 3.0;
    let apart_deg = matching.observations.rows.iter().filter_map(|row| {
        let commanded = plan.rows.get((row.index as usize).checked_sub(1)?)?;
        let apart = row
            .axes
            .degrees()
            .into_iter()
            .zip(commanded.axes_deg)
            .map(|(measured, plan)| (measured - plan).abs());
        Some(apart.fold(0.0, f64::max))
    });
    let mut apart_deg: Vec<f64> = apart_deg.collect();
    apart_deg.sort_by(f64::total_cmp);
    let (usual_deg, worst_deg) = (*apart_deg.get(apart_deg.len() / 2)?, *apart_deg.last()?);
    if worst_deg <= IN_POSITION_DEG {
        return None;
    }
    let poses = apart_deg.iter().filter(|deg| **deg > IN_POSITION_DEG).count();
    Some(if usual_deg > CORRECTED_DEG {
        Finding::OtherPlanDriven { poses, worst_deg }
    } else if usual_deg > IN_POSITION_DEG {
        Finding::AxesCorrected { poses, worst_deg }
    } else {
        Finding::AxesMoved { poses, worst_deg }
    })
}

/// Probability of a warning about drift in a run without drift.
const DRIFT_RISK: f64 = 0.05;

/// The drift of the repeated poses that is least likely by chance; the largest, if none has a standard deviation.
pub(super) fn largest_drift(
    rows: &[&PlanRow],
    outcomes: &[PoseOutcome],
    bar_sigma_mm: f64,
) -> Option<LengthDrift> {
    let mut groups: Vec<(&PlanRow, Vec<[f64; 2]>)> = Vec::new();
    for (row, pose) in rows.iter().zip(outcomes).filter(|(row, _)| row.kind == PoseKind::Reference) {
        let Some(reading) = pose.reading() else { continue };
        let point = [reading.middle_s(), reading.reading_mm];
        match groups
            .iter_mut()
            .find(|(first, _)| first.centre == row.centre && first.axes_deg == row.axes_deg)
        {
            Some((_, points)) => points.push(point),
            None => groups.push((row, vec![point])),
        }
    }
    let drifts: Vec<LengthDrift> = groups.iter().filter_map(|(_, points)| drift_line(points)).collect();
    // The risk is of the whole run: each pose that can show a drift has its share.
    let judged = drifts.iter().filter(|drift| drift.sd_mm.is_some()).count().max(1);
    let most = drifts.into_iter().min_by(|a, b| {
        let by_size = b.change_mm.abs().total_cmp(&a.change_mm.abs());
        a.by_chance().total_cmp(&b.by_chance()).then(by_size)
    })?;
    let is_rare = most.by_chance() < DRIFT_RISK / judged as f64;
    let significant = is_rare && most.change_mm.abs() > bar_sigma_mm;
    Some(LengthDrift { significant, ..most })
}

/// The drift by a line through points; these are times, s, and readings, mm, in order of time.
fn drift_line(points: &[[f64; 2]]) -> Option<LengthDrift> {
    let readings = points.len();
    let span_s = points.last()?[0] - points.first()?[0];
    let line = RegressionLine::through(points).filter(|_| span_s > 0.0)?;
    let change_mm = line.slope * span_s;
    let sd_mm = (readings > 2).then_some(line.slope_sd * span_s);
    Some(LengthDrift { change_mm, sd_mm, readings, significant: false })
}

/// Least number of dwells that show whether the reading changes at rest, and between dwells.
const MIN_DWELLS: usize = 5;
/// Least share of the other dwells, or of the moves between them, in which the reading changes if the bar does not
/// freeze.
const ALIVE: f64 = 0.95;
/// Longest constant reading of a bar whose reading changes at rest, in dwells.
const DWELLS: f64 = 5.0;
/// Longest constant reading of a coarse bar, in poses.
const MAX_CONSTANT_POSES: usize = 3;

/// The longest interval of constant reading that holds the motion between two poses, unless the scale of the bar
/// is so coarse that such intervals are usual.
pub(super) fn detect_frozen_reading(stream: &SampleStream, outcomes: &[PoseOutcome]) -> Option<Finding> {
    let longest = longest_constant(stream)?;
    let (from_s, to_s) = (stream.t_s[longest.start], stream.t_s[longest.end - 1]);
    let is_within = |pose: &&PoseOutcome| {
        pose.reading().is_some_and(|reading| reading.to_s > from_s && reading.from_s < to_s)
    };
    let read = outcomes.iter().filter(is_within).count();
    // Poses without a reading count between neighbours with one; before the first and after the last the bar is off.
    let before =
        outcomes.iter().rposition(|pose| pose.reading().is_some_and(|reading| reading.to_s <= from_s));
    let after = outcomes.iter().position(|pose| pose.reading().is_some_and(|reading| reading.from_s >= to_s));
    let between = before.zip(after).and_then(|(before, after)| outcomes.get(before + 1..after));
    let poses = between.map_or(read, <[PoseOutcome]>::len);
    let others: Vec<&DwellReading> =
        outcomes.iter().filter(|pose| !is_within(pose)).filter_map(PoseOutcome::reading).collect();
    if others.len() < MIN_DWELLS {
        return None;
    }
    let changes = |from_s: f64, to_s: f64| !is_constant(stream, stream.at(from_s)..stream.at(to_s));
    let at_rest = others.iter().filter(|dwell| changes(dwell.from_s, dwell.to_s)).count();
    let moved = others.windows(2).filter(|pair| changes(pair[0].from_s, pair[1].to_s)).count();
    let dwell_s = median(&mut others.iter().map(|dwell| dwell.to_s - dwell.from_s).collect::<Vec<_>>())?;
    let is_alive = |count: usize, of: usize| count as f64 >= ALIVE * of as f64;
    let is_frozen = if is_alive(at_rest, others.len()) {
        poses >= 2 && to_s - from_s > DWELLS * dwell_s
    } else {
        read >= MAX_CONSTANT_POSES && is_alive(moved, others.len() - 1)
    };
    is_frozen.then(|| Finding::Frozen { from_s, to_s, poses, reading_mm: stream.reading_mm[longest.start] })
}

/// The longest run of equal valid samples.
fn longest_constant(stream: &SampleStream) -> Option<Range<usize>> {
    let count = stream.reading_mm.len();
    let equal = |at: usize| stream.valid(at) && stream.reading_mm[at] == stream.reading_mm[at - 1];
    let (mut start, mut longest) = (0, 0..0);
    let lasts_s = |range: &Range<usize>| stream.t_s[range.end - 1] - stream.t_s[range.start];
    for end in 1..=count {
        if end < count && equal(end) {
            continue;
        }
        if stream.valid(start) && (longest.is_empty() || lasts_s(&(start..end)) > lasts_s(&longest)) {
            longest = start..end;
        }
        start = end;
    }
    (longest.len() > 2).then_some(longest)
}

fn is_constant(stream: &SampleStream, samples: Range<usize>) -> bool {
    samples.skip(1).all(|at| stream.reading_mm[at] == stream.reading_mm[at - 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::plan::example::row;
    use crate::recording::stream::StreamBuilder;
    use dbbd_model::base::units::HostNs;
    use dbbd_model::measurement::sample::Sample;

    /// The line through 0, 0.1, 0.2, 0.34 rises by 0.112 a second (residuals 0.008, -0.004, -0.016, 0.012 squared
    /// sum to 0.00048, over 2 degrees of freedom and sum of squares 5): sd sqrt(0.00024 / 5) a second.
    #[test]
    fn drift_is_the_rise_of_the_line() {
        let drift = drift_line(&[[0.0, 0.0], [1.0, 0.1], [2.0, 0.2], [3.0, 0.34]]).unwrap();
        assert!((drift.change_mm - 0.336).abs() < 1e-12, "{drift:?}");
        assert!((drift.sd_mm.unwrap() - 3.0 * 0.000_048_f64.sqrt()).abs() < 1e-12, "{drift:?}");
        assert_eq!(drift.readings, 4);
    }

    fn read(row: &PlanRow, middle_s: f64, reading_mm: f64) -> PoseOutcome {
        let (from_s, to_s) = (middle_s - 0.25, middle_s + 0.25);
        let reading = DwellReading {
            from_s,
            to_s,
            reading_mm,
            u_mm: 0.001,
            samples: 100,
            invalid: 0,
            gaps: 0,
            creep_mm: None,
        };
        PoseOutcome { index: row.index, outcome: MatchOutcome::Matched { reading, posterior: 1.0 } }
    }

    /// Three readings have one degree of freedom: the tail beyond t is 2 atan(1 / t) / pi, so that t is 12.71 for one pose in
    /// twenty, and 38.19 for one of three. The line through 0, a, 1 has the change 1 and the standard deviation
    /// |a - 1 / 2| 2 / sqrt(3).
    #[test]
    fn drift_of_several_poses_must_be_larger() {
        let largest = |middles: &[f64], bar_sigma_mm: f64| {
            let rows: Vec<PlanRow> = (0..3 * middles.len())
                .map(|at| PlanRow { axes_deg: [(at / 3) as f64; 6], ..row(PoseKind::Reference) })
                .collect();
            let outcomes: Vec<PoseOutcome> = rows
                .iter()
                .zip(middles.iter().flat_map(|middle| [0.0, *middle, 1.0]))
                .enumerate()
                .map(|(at, (row, reading_mm))| read(row, at as f64, reading_mm))
                .collect();
            largest_drift(&rows.iter().collect::<Vec<_>>(), &outcomes, bar_sigma_mm).unwrap()
        };
        let significant = |middles: &[f64]| largest(middles, 0.01).significant;
        assert!(significant(&[0.567]) && !significant(&[0.569]));
        assert!(significant(&[0.9, 0.5226, 0.1]) && !significant(&[0.9, 0.5228, 0.1]));
        // A bar that scatters by more explains it.
        assert!(largest(&[0.51], 0.99).significant && !largest(&[0.51], 1.01).significant);
        // Of several poses the one with the least scatter counts; two readings have none.
        assert!((largest(&[0.9, 0.55, 0.1], 0.01).sd_mm.unwrap() - 0.1 / 3.0_f64.sqrt()).abs() < 1e-12);
        let two = drift_line(&[[0.0, 0.0], [1.0, 1.0]]).unwrap();
        assert_eq!((two.sd_mm, two.by_chance(), two.readings), (None, 1.0, 2));
        assert_eq!(drift_line(&[[1.0, 0.0], [1.0, 1.0]]), None);
        assert_eq!(drift_line(&[]), None);
    }

    #[test]
    fn longest_run_of_equal_readings() {
        let longest = |readings_mm: &[f64]| {
            let mut builder = StreamBuilder::new(None);
            for (at, reading_mm) in (0..).zip(readings_mm) {
                let sample = Sample { valid: *reading_mm < 10.0, ..Sample::of(*reading_mm) };
                builder.push(HostNs(at * 1_000_000), &sample);
            }
            longest_constant(&builder.build())
        };
        assert_eq!(longest(&[1.0, 2.0, 2.0, 2.0, 1.0, 1.0]), Some(1..4));
        assert_eq!(longest(&[1.0, 2.0, 2.0, 2.0, 2.0]), Some(1..5));
        assert_eq!(longest(&[1.0, 1.0, 2.0, 2.0]), None);
        assert_eq!(longest(&[99.0, 99.0, 99.0, 2.0, 2.0, 2.0]), Some(3..6));
        assert_eq!(longest(&[]), None);
    }

    #[test]
    fn odds_of_a_module_grow_with_its_dwells() {
        let is_foreign = |log_odds, matched| ModuleOdds { log_odds, dwells: 20, matched }.is_foreign();
        // Seven intervals need 7 ln 2 = 4.85; without a pair only odds of 1 : 5 count.
        assert!(is_foreign(4.8, 8) && !is_foreign(4.9, 8));
        assert!(is_foreign(-1.7, 0) && !is_foreign(-1.5, 0) && !is_foreign(-1.5, 1));
        // Odds of a million suffice however many dwells there are.
        assert!(!is_foreign(13.9, 200) && is_foreign(13.7, 200));
        let odds = |dwells, log_odds: [f64; 2]| CodeOdds {
            by_module: log_odds.map(|log_odds| ModuleOdds { log_odds, dwells, matched: 5 }).to_vec(),
        };
        assert!(odds(12, [7.0, 7.0]).is_own() && !odds(12, [7.0, 6.0]).is_own());
        assert_eq!(odds(12, [20.0, -7.0]).foreign_module(), Some(2));
        // Small modules count together: nine intervals need 6.2.
        assert_eq!(odds(8, [20.0, -7.0]).foreign_module(), None);
        assert_eq!(odds(8, [9.0, -7.0]).foreign_module(), Some(2));
    }

    #[test]
    fn share_is_in_percent() {
        assert_eq!(percent(1, 8), 12.5);
    }
}
