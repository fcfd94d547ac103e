//! What an identification starts from: an observations CSV with its robot and balls, or a capture.

use std::path::Path;

use super::inputs::{self, measurements};
use super::{LENGTHS, POSITIONS};
use crate::catalogue::{
    ConformityFinding, EstimationFinding, MatchingFinding, ProvenanceFinding, RecordingFinding,
};
use crate::cli::Output;
use crate::cli::robots;
use crate::diagnostic::{Diagnostic, Finding, Severity};
use crate::estimation::{AngleSource, CalibrationResult, Input, Options, Prior, check_measurements, doubts};
use crate::measurement::{BaseBall, LengthModel, Measurements};
use crate::provenance::{
    Artefact, BarIdentity, Contradiction, Difference, Identity, Provenance, Role, Traced, one_robot,
};
use crate::recording::matching::PoseMatching;
use crate::recording::run::{self, Predicted, Run};
use crate::robot::{AXES, BallId, BarId, Robot, RobotRead};

/// Least standard deviation with which a predicted length speaks in the alignment, mm.
const LEAST_SIGMA_MM: f64 = 0.02;

/// What the command line names of lengths, robot and set-up.
#[derive(Clone, Copy)]
pub(crate) struct Named<'a> {
    pub(crate) input: &'a Path,
    /// Positions beside the lengths of the input.
    pub(crate) positions: Option<&'a Path>,
    pub(crate) robot: Option<&'a str>,
    pub(crate) tool: Option<[f64; 3]>,
    pub(crate) centres: Option<&'a Path>,
    pub(crate) bar_u: Option<f64>,
}

impl Named<'_> {
    /// An option that is of use with lengths alone.
    fn of_lengths(&self) -> Option<&'static str> {
        let centres = self.centres.map(|_| "--centres");
        centres.or(self.bar_u.map(|_| "--bar-u"))
    }
}

/// Robot, base balls and lengths.
pub(crate) struct Given {
    pub(crate) robot: Robot,
    pub(crate) centres: Vec<BaseBall>,
    pub(crate) observations: Measurements,
    /// Those of the positions' own table.
    positions: Option<Measurements>,
    /// Standard uncertainty of the bar's length, mm, where it has a certificate.
    pub(crate) bar_u_mm: Option<f64>,
    pub(crate) provenance: Provenance,
    /// The table or the capture of the lengths.
    lengths: Traced,
    /// Of the inputs as they were read.
    pub(crate) findings: Vec<Diagnostic>,
    /// Of a run as it was matched last: lost parts, poses dropped as ambiguous, another robot.
    of_run: Vec<Diagnostic>,
    pub(crate) axes: AngleSource,
    /// The capture that the lengths come from, and how it was matched last.
    joined: Option<(Box<Run>, PoseMatching)>,
}

impl Given {
    /// Reads what the command line names.
    ///
    /// # Errors
    /// What is missing or wrong, with its file and line.
    pub(crate) fn read(named: Named<'_>, out: &Output) -> Result<Self, Diagnostic> {
        let input = named.input.display().to_string();
        let joined = if run::is_capture(named.input)? {
            let run = run::open(named.input, None, &[], &mut |finding| out.finding(finding))?;
            let matching = run.matching(None)?;
            Some((Box::new(run), matching))
        } else {
            None
        };
        let mut findings = Vec::new();
        let observations = match &joined {
            Some((_, matching)) => matching.observations.clone(),
            None => measurements(named.input, &mut findings, out)?,
        };
        let is_tracked = observations.set_up(0).trackers > 0;
        if is_tracked && named.positions.is_some() {
            return Err(EstimationFinding::PositionsTwice.into());
        }
        if observations.rows.is_empty() {
            return Err(Diagnostic::file(&input, EstimationFinding::NoLength));
        }
        if is_tracked && let Some(option) = named.of_lengths() {
            return Err(EstimationFinding::OfLengths { option }.into());
        }
        let run = joined.as_ref().map(|(run, _)| run.as_ref());
        let lengths = match run {
            Some(run) => run.traced(named.input)?,
            None => {
                let (lengths, changed) = Traced::table(Role::Measurements, named.input)?;
                findings.extend(changed);
                lengths
            }
        };
        let (mut robot, mut sources) = (robot(named.robot, run, &lengths, out)?, Vec::new());
        if let Some(tool) = named.tool {
            robot.robot.set_tool(tool);
        }
        let centres = match (named.centres, run) {
            (Some(path), _) => {
                sources.push(Artefact::file(Role::BaseBalls, path)?.into());
                out.table(path, BaseBall::from_table)?
            }
            (None, Some(run)) => run.centres(),
            (None, None) if is_tracked => Vec::new(),
            (None, None) => return Err(EstimationFinding::NoBalls.into()),
        };
        let RobotRead { robot, source, .. } = robot;
        check_measurements(&input, &observations, &robot, &centres)?;
        findings.extend(doubts(&input, &observations, &robot, &centres));
        let positions = named.positions.map(|path| {
            sources.push(beside(path, &lengths, &mut findings)?);
            positions(path, &robot, &mut findings, out)
        });
        let positions = positions.transpose()?;
        let observations = joined_with(observations, positions.as_ref())?;
        let of_run = joined.as_ref().map_or_else(Vec::new, |(run, matching)| of_run(run, matching, &robot));
        let measured = |(run, matching): &(Box<Run>, PoseMatching)| {
            !run.axes_deg.is_empty() || matching.axes.as_ref().is_some_and(|axes| axes.measured > 0)
        };
        let axes = match &joined {
            Some(joined) if !measured(joined) => AngleSource::Commanded,
            _ => AngleSource::Given,
        };
        let provenance = Provenance::of([&source].into_iter().chain(&sources).chain([&lengths]));
        let warm = warm_bar(&observations, &provenance.identity.bar).filter(|_| joined.is_none());
        findings.extend(warm.map(|finding| Diagnostic::file(&input, finding)));
        let bar_u_mm = named.bar_u.or(provenance.identity.bar.u_mm());
        Ok(Self {
            robot,
            centres,
            observations,
            positions,
            bar_u_mm,
            provenance,
            lengths,
            findings,
            of_run,
            axes,
            joined,
        })
    }

    /// Measurements that only check: in the same set-up, of the same robot.
    ///
    /// # Errors
    /// They cannot be read, or are of another robot.
    pub(super) fn validation(&mut self, path: &Path, out: &Output) -> Result<Measurements, Diagnostic> {
        let (name, set) = (path.display().to_string(), measurements(path, &mut self.findings, out)?);
        check_measurements(&name, &set, &self.robot, &self.centres)?;
        set.check(&name, self.observations.set_up(self.centres.len()))?;
        let Traced { artefact, .. } = beside(path, &self.lengths, &mut self.findings)?;
        if self.provenance.has(&artefact) {
            out.finding(ProvenanceFinding::GivenTwice { lengths: artefact.to_string() });
        }
        Ok(set)
    }

    /// That the plan of a run is for `robot`.
    ///
    /// # Errors
    /// The run is of a plan for another one.
    pub(crate) fn planned_for(&self, robot: &Robot) -> Result<(), ConformityFinding> {
        let planned = self.joined.as_ref().and_then(|(run, _)| run.robot().ok());
        match planned.filter(|planned| planned.name != robot.name) {
            Some(planned) => {
                Err(ConformityFinding::PlanOfAnother { planned: planned.name, given: robot.name.clone() })
            }
            None => Ok(()),
        }
    }

    /// What was found in the inputs.
    pub(crate) fn findings(&self) -> Vec<Diagnostic> {
        [self.findings.as_slice(), self.of_run.as_slice()].concat()
    }

    /// The prior where the user names none: a robot that was identified before is known as that left it. Where its file
    /// does not hold it, that is lost.
    ///
    /// # Errors
    /// The lengths beside the robot's file cannot be read.
    pub(super) fn continued(&mut self, robot_file: Option<&str>, out: &Output) -> Result<Prior, Diagnostic> {
        let known = || self.known_lengths(robot_file, out);
        let (prior, lost) = Prior::continued(&self.robot, self.observations.rows.len(), known)?;
        self.findings.extend(lost.map(Diagnostic::from));
        Ok(prior)
    }

    /// How many of the lengths are among those beside the robot's file, from which it was identified.
    ///
    /// # Errors
    /// These cannot be read.
    pub(crate) fn known_lengths(&self, robot_file: Option<&str>, out: &Output) -> Result<usize, Diagnostic> {
        let beside = [LENGTHS, POSITIONS]
            .into_iter()
            .filter_map(|file| Some(Path::new(robot_file?).with_file_name(file)));
        let known = beside.filter(|path| path.is_file()).map(|path| {
            let table = measurements(&path, &mut Vec::new(), out)?;
            Ok(table.holds(&self.observations))
        });
        known.sum()
    }

    /// The robot in the set-up as it was given.
    pub(super) fn start(&self) -> LengthModel {
        LengthModel::before(self.robot.geometry.clone(), &self.centres, &self.observations)
    }

    pub(super) fn input<'a>(&'a self, start: &'a LengthModel, options: &'a Options) -> Input<'a> {
        let Self { robot, observations, axes, .. } = self;
        Input { robot, observations, start, validation: None, options, axes: *axes }
    }

    /// Joins the capture anew with the lengths that the identified robot predicts; whether the pairs changed.
    pub(super) fn align_again(&mut self, found: &CalibrationResult) -> bool {
        let Some((run, before)) = &mut self.joined else { return false };
        let model = &found.posterior.model;
        let length = |ball: BallId, axes_deg: &[f64; AXES]| match model.balls.get(ball.index()) {
            Some(centre) => {
                model.geometry.length(&axes_deg.map(f64::to_radians), centre, model.bar_offset(BarId::FIRST))
            }
            None => f64::NAN,
        };
        let sigma_mm = (3.0 * found.sigma.mm).max(LEAST_SIGMA_MM);
        let Ok(matching) = run.matching(Some(Predicted { length_mm: &length, sigma_mm })) else {
            return false;
        };
        if matching.same_pairs(before) || matching.observations.rows.is_empty() {
            return false;
        }
        let Ok(observations) = joined_with(matching.observations.clone(), self.positions.as_ref()) else {
            return false;
        };
        self.observations = observations;
        self.of_run = of_run(run, &matching, &self.robot);
        *before = matching;
        true
    }
}

/// That the bar of a table was warm or cold, and nothing shows that its lengths are referred to its certificate.
fn warm_bar(observations: &Measurements, bar: &BarIdentity) -> Option<RecordingFinding> {
    let lengths = observations.rows.iter().filter(|row| row.datum.bar().is_some());
    let longest_mm = lengths.map(|row| row.length_mm).reduce(f64::max)?;
    // No room is so warm or cold, which is doubted elsewhere.
    let mean_c = observations.mean_temperature_c().filter(|_| observations.warm().is_none())?;
    bar.uncorrected(bar.length_mm.unwrap_or(longest_mm), mean_c)
}

/// A further table of measurements, which must be of the robot of `lengths`; that bar or balls are others is a finding.
///
/// # Errors
/// It cannot be read, or is of another robot.
fn beside(path: &Path, lengths: &Traced, findings: &mut Vec<Diagnostic>) -> Result<Traced, Diagnostic> {
    let name = path.display().to_string();
    let (table, changed) = Traced::table(Role::Measurements, path)?;
    findings.extend(changed);
    one_robot([(lengths.artefact.name.clone(), lengths), (name.clone(), &table)])?;
    let others = lengths.provenance.identity.contradictions(&table.provenance.identity).into_iter();
    let of_set_up = |key: &str| key == BarIdentity::SERIAL || key.starts_with(Identity::BALLS);
    let others = others.filter(|other| of_set_up(&other.key));
    findings.extend(others.map(|Contradiction { key, known, stated }| {
        Diagnostic::file(&name, ProvenanceFinding::OtherSetUp { key, known, stated })
    }));
    Ok(table)
}

/// Positions beside lengths, with what is doubtful in them.
fn positions(
    path: &Path,
    robot: &Robot,
    findings: &mut Vec<Diagnostic>,
    out: &Output,
) -> Result<Measurements, Diagnostic> {
    let (name, set) = (path.display().to_string(), inputs::positions(path, findings, out)?);
    check_measurements(&name, &set, robot, &[])?;
    findings.extend(
        doubts(&name, &set, robot, &[]).into_iter().filter(|doubt| doubt.code.severity() != Severity::Info),
    );
    Ok(set)
}

/// Lengths with the positions of a further table.
fn joined_with(lengths: Measurements, positions: Option<&Measurements>) -> Result<Measurements, Diagnostic> {
    Ok(positions.map_or(Ok(lengths.clone()), |positions| lengths.and(positions))?)
}

/// The robot of the command line, else that of the run's plan; it must be that of the lengths.
fn robot(
    named: Option<&str>,
    run: Option<&Run>,
    lengths: &Traced,
    out: &Output,
) -> Result<RobotRead, Diagnostic> {
    let found = match (named, run) {
        (Some(name), _) => robots::from_file(name, out)?,
        (None, Some(run)) => {
            let (robot, text) = (run.robot()?, &run.plan.header.robot);
            // A plan that has no chain knows its robot all the same.
            let recorded = lengths.robot().map(|robot| Traced::from(robot.clone()));
            let source = recorded.unwrap_or_else(|| robot.traced(text));
            return Ok(RobotRead { source, robot, findings: Vec::new() });
        }
        (None, None) => return Err(EstimationFinding::NoRobot.into()),
    };
    let given = &found.source;
    if let Some(planned) = lengths.robot()
        && planned.differs(&given.artefact) == Some(Difference::Serial)
    {
        return Err(lengths.of_another_robot(planned, &given.artefact).into());
    }
    one_robot([(lengths.artefact.name.clone(), lengths), (given.artefact.name.clone(), given)])?;
    if given.provenance.has(&lengths.artefact) {
        let (lengths, robot) = (lengths.artefact.to_string(), given.artefact.to_string());
        out.finding(ProvenanceFinding::UsedBefore { lengths, robot });
    } else {
        lengths.outdated_by(given).into_iter().for_each(|finding| out.finding(finding));
    }
    Ok(found)
}

/// Parts of the run that were lost, poses that were dropped, and another robot than the plan's.
fn of_run(run: &Run, matching: &PoseMatching, robot: &Robot) -> Vec<Diagnostic> {
    let torn = run.doubtful.then(|| EstimationFinding::PartOfRunLost.into());
    let is_axes = |finding: &MatchingFinding| {
        matches!(
            finding,
            MatchingFinding::AxesMeasured { .. } | MatchingFinding::AxesMeasuredLagUnknown { .. }
        )
    };
    let warnings = matching
        .findings
        .iter()
        .filter(|finding| finding.code().severity() == Severity::Warning || is_axes(finding));
    let planned = run.robot().ok().map(|planned| planned.name).filter(|name| *name != robot.name);
    let other = planned
        .map(|planned| EstimationFinding::PlannedForAnother { planned, given: robot.name.clone() }.into());
    torn.into_iter().chain(warnings.cloned().map(Diagnostic::from)).chain(other).collect()
}
