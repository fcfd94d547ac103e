//! The inputs of an identification or a check: measurements from tables or a capture, the robot, and the base balls.

use std::path::{Path, PathBuf};

use super::exclusion::{AppliedExclusion, Exclusion};
use super::matched_run::MatchedRun;
use super::parts::{self, InputPart, JoinedParts, SetUpRelation, sort_by_time};
use super::tables::{lengths_or_positions, measurements};
use super::{AskedIdentification, LENGTHS, POSITIONS};
use crate::recording::run::{PredictedLengths, RecordedRun};
use crate::request::RequestSession;
use crate::request::robots::{aged, robot_for_measurement};
use crate::robot_files::RobotName;
use dbbd_model::conformity::ConformityFinding;
use dbbd_model::diagnostic::{Diagnostic, Severity};
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::estimation::{
    AngleSource, CompletedCalibration, Options, check_measurements, measurement_findings,
};
use dbbd_model::measurement::{BaseBall, Measurements};
use dbbd_model::provenance::IdentityFinding;
use dbbd_model::provenance::ProvenanceFinding;
use dbbd_model::provenance::{
    ArtefactDifference, ArtefactRole, BarIdentity, Contradiction, Identity, MeasuredTemperature, Provenance,
    TracedArtefact, one_robot,
};
use dbbd_model::robot::parameter::SetUpCounts;
use dbbd_model::robot::{AXES, BallId, LoadedRobot, MeasurementConditions, Robot};

/// The least standard deviation of a predicted length in the pose matching, mm.
const MIN_PREDICTED_SIGMA_MM: f64 = 0.02;

/// The inputs as a request names them.
#[derive(Clone, Copy)]
pub(crate) struct NamedInputs<'a> {
    pub(crate) input: &'a Path,
    /// Further captures and tables of the same robot.
    pub(crate) further: &'a [PathBuf],
    pub(crate) set_ups: SetUpRelation,
    /// Positions beside the lengths of the input.
    pub(crate) positions: Option<&'a Path>,
    pub(crate) robot: Option<&'a RobotName>,
    pub(crate) tool_mm: Option<[f64; 3]>,
    pub(crate) centres: Option<&'a Path>,
    pub(crate) bar_u_mm: Option<f64>,
    /// Rows that are left out.
    pub(crate) exclude: &'a [Exclusion],
}

/// The inputs as they were read.
pub(crate) struct LoadedInputs {
    pub(crate) robot: Robot,
    pub(crate) centres: Vec<BaseBall>,
    pub(crate) observations: Measurements,
    /// The positions from a separate table, which are also among the observations.
    positions: Option<Measurements>,
    /// Standard uncertainty of the bar's length as the request states it, mm.
    stated_bar_u_mm: Option<f64>,
    pub(crate) provenance: Provenance,
    /// Date and temperature of the measurement of the lengths.
    pub(crate) measured: MeasurementConditions,
    findings: Vec<Diagnostic>,
    pub(crate) axes: AngleSource,
    /// The captures and tables with the lengths; the first is always there.
    parts: Vec<InputPart>,
    left_out: AppliedExclusion,
}

impl LoadedInputs {
    pub(crate) fn read(named: NamedInputs<'_>, session: &RequestSession<'_>) -> Result<Self, Diagnostic> {
        let mut findings = Vec::new();
        let mut parts = vec![InputPart::read(named.input, session, &mut findings)?];
        for path in named.further {
            let part = InputPart::read(path, session, &mut findings)?;
            check_further(&part, &parts, &mut findings)?;
            parts.push(part);
        }
        sort_by_time(&mut parts);
        let first = &parts[0];
        let input = first.path.display().to_string();
        let is_tracked = first.measurements.set_up(0).trackers > 0;
        if is_tracked && named.positions.is_some() {
            return Err(EstimationFinding::PositionsTwice.into());
        }
        let of_lengths = named
            .centres
            .map(|_| "the table of base balls")
            .or(named.bar_u_mm.map(|_| "the uncertainty of the bar"));
        if is_tracked && let Some(input) = of_lengths {
            return Err(EstimationFinding::OfLengths { input }.into());
        }
        let run = first.matched.as_ref().map(|matched| matched.run.as_ref());
        let LoadedRobot { mut robot, source, .. } = read_robot(named.robot, run, &first.lengths, session)?;
        if let Some(tool) = named.tool_mm {
            robot.set_tool(tool);
        } else if !robot.has_tool
            && let Some(planned) = run.and_then(|run| run.robot().ok())
        {
            // The robot of the catalogue was measured with the tool of the plan.
            robot.set_tool(planned.controller().geometry.tool.into());
        }
        robot.check_tool()?;
        let mut sources = Vec::new();
        let centres = match (named.centres, run) {
            (Some(path), _) => {
                sources.push(crate::artefact::of_file(ArtefactRole::BaseBalls, path)?.into());
                session.table(path, BaseBall::from_table)?
            }
            (None, Some(run)) => run.centres(),
            (None, None) if is_tracked => Vec::new(),
            (None, None) => return Err(EstimationFinding::NoBalls.into()),
        };
        let JoinedParts { measurements: observations, centres } =
            JoinedParts::of(&mut parts, centres, named.set_ups, &mut findings)?;
        let lengths = &parts[0].lengths;
        let matched = &parts[0].matched;
        let load = &robot.geometry.load;
        let mut observations =
            observations.carrying(load).map_err(|finding| Diagnostic::file(&input, finding))?;
        let left_out = AppliedExclusion::of(&mut observations, named.exclude)
            .map_err(|finding| Diagnostic::file(&input, finding))?;
        findings.extend(left_out.finding());
        check_measurements(&input, &observations, &robot, &centres)?;
        findings.extend(measurement_findings(&input, &observations, &robot, &centres));
        let mut positions = None;
        if let Some(path) = named.positions {
            sources.push(read_further(path, lengths, &mut findings)?);
            positions = Some(read_positions(path, &robot, &mut findings, session)?);
        }
        let observations = with_positions(observations, positions.as_ref())?;
        let lengths = parts.iter().map(|part| &part.lengths);
        let provenance = crate::artefact::made_from([&source].into_iter().chain(&sources).chain(lengths));
        findings.extend(provenance.of_origin().map(Diagnostic::from));
        let identities = parts.iter().map(|part| &part.lengths.provenance.identity);
        let measured = measured_conditions(identities, &observations);
        let bar = &provenance.identity.bar;
        let uncorrected = uncorrected_bar(&observations, bar).filter(|_| matched.is_none());
        findings.extend(uncorrected.map(|finding| Diagnostic::file(&input, finding)));
        Ok(Self {
            stated_bar_u_mm: named.bar_u_mm,
            axes: angle_source(&parts),
            robot,
            centres,
            observations,
            positions,
            provenance,
            measured,
            findings,
            parts,
            left_out,
        })
    }

    /// Standard uncertainty of the bar's length, mm, if known: the stated one, else the one of its certificate, and the
    /// one due to its temperature.
    pub(crate) fn bar_u_mm(&self) -> Option<f64> {
        self.provenance.identity.bar_u_mm(self.stated_bar_u_mm)
    }

    /// Ages the robot to the day on which the lengths were measured: the day that the lengths or `stated` tell, else
    /// today.
    pub(crate) fn age_robot(&mut self, stated: Option<&Identity>) {
        if let Some(stated) = stated {
            self.measured.date = stated.measured.clone().or(self.measured.date.take());
            self.measured.temperature_c = temperature_c(stated).or(self.measured.temperature_c);
        }
        self.robot = aged(&self.robot, &mut self.measured);
    }

    /// Reads measurements that only check the result. They must be of the same robot in the same set-up.
    pub(super) fn validation(
        &mut self,
        path: &Path,
        session: &RequestSession<'_>,
    ) -> Result<Measurements, Diagnostic> {
        let name = path.display().to_string();
        let set = measurements(path, lengths_or_positions, &mut self.findings, session)?;
        let set =
            set.carrying(&self.robot.geometry.load).map_err(|finding| Diagnostic::file(&name, finding))?;
        check_measurements(&name, &set, &self.robot, &self.centres)?;
        set.check(&name, self.observations.set_up(self.centres.len()))?;
        let TracedArtefact { artefact, .. } = read_further(path, &self.parts[0].lengths, &mut self.findings)?;
        let mut used = self.parts.iter().map(|part| &part.measurements).chain(&self.positions);
        if used.any(|used| used.repeats(&set)) {
            session.finding(ProvenanceFinding::GivenTwice { lengths: artefact.to_string() });
        }
        Ok(set)
    }

    /// Refuses a run whose plan is for another robot.
    pub(crate) fn check_planned_robot(&self) -> Result<(), ConformityFinding> {
        let mut runs = self.parts.iter().filter_map(|part| part.matched.as_ref());
        let planned = runs.find_map(|matched| matched.other_robot(&self.robot));
        let given = || self.robot.name.clone();
        planned.map_or(Ok(()), |planned| Err(ConformityFinding::PlanOfAnother { planned, given: given() }))
    }

    /// Adds the rows that were left out to the result.
    pub(super) fn with_excluded(&self, calibration: CompletedCalibration) -> CompletedCalibration {
        self.left_out.listed_in(calibration, self.provenance.identity.operator.as_deref())
    }

    pub(crate) fn findings(&self) -> Vec<Diagnostic> {
        [self.findings.clone(), run_findings(&self.parts, &self.robot)].concat()
    }

    /// The options of an identification; `prior` is the file of its prior. Reports that the robot file has lost its
    /// posterior.
    pub(super) fn options(
        &mut self,
        asked: AskedIdentification<'_>,
        prior: Option<&Path>,
        set_up: SetUpCounts,
    ) -> Result<Options, Diagnostic> {
        let (known, rows) = (|| known_lengths(prior, &self.observations), self.observations.rows.len());
        let (options, lost) = asked.options(&self.robot, rows, set_up, known)?;
        self.findings.extend(lost.map(Diagnostic::from));
        Ok(options)
    }

    /// Matches the captures again with the lengths that the identified robot predicts. Returns whether the pairs changed.
    pub(super) fn match_again(&mut self, calibration: &CompletedCalibration) -> bool {
        let model = &calibration.posterior.model;
        let sigma_mm = (3.0 * calibration.result.noise_mm.length).max(MIN_PREDICTED_SIGMA_MM);
        let mut replaced = Vec::new();
        for (at, part) in self.parts.iter_mut().enumerate() {
            let (first_ball, bar) = (part.set_up.first_ball, part.set_up.bar());
            let length =
                |ball: BallId, axes_deg: &[f64; AXES]| match model.balls.get(first_ball + ball.index()) {
                    Some(centre) => {
                        model.geometry.length(&axes_deg.map(f64::to_radians), centre, model.bar_offset(bar))
                    }
                    None => f64::NAN,
                };
            let Some(MatchedRun { run, matching: before }) = &mut part.matched else { continue };
            let Ok(matching) = run.matching(Some(PredictedLengths { length_mm: &length, sigma_mm })) else {
                continue;
            };
            if matching.same_pairs(before) || matching.observations.rows.is_empty() {
                continue;
            }
            part.measurements = matching.observations.clone();
            replaced.push((at, std::mem::replace(before, matching)));
        }
        if replaced.is_empty() {
            return false;
        }
        if let Some((left_out, observations)) = self.joined_again() {
            (self.left_out, self.observations) = (left_out, observations);
            return true;
        }
        for (at, before) in replaced {
            self.parts[at].measurements = before.observations.clone();
            self.parts[at].matched.iter_mut().for_each(|matched| matched.matching = before.clone());
        }
        false
    }

    /// The observations of the parts as they are now matched; `None` if nothing can be estimated from them.
    fn joined_again(&self) -> Option<(AppliedExclusion, Measurements)> {
        let (lengths, _) = parts::joined(&self.parts).ok()?;
        let mut lengths = lengths.carrying(&self.robot.geometry.load).ok()?;
        let left_out = self.left_out.again(&mut lengths).ok()?;
        Some((left_out, with_positions(lengths, self.positions.as_ref()).ok()?))
    }
}

/// The number of observations from which a robot or a prior was identified: those in the tables beside its file. What was read
/// from no file has no tables beside it.
pub fn known_lengths(file: Option<&Path>, observations: &Measurements) -> Result<usize, Diagnostic> {
    let Some(file) = file else { return Ok(0) };
    let session = RequestSession::new(&());
    let tables = [LENGTHS, POSITIONS].map(|name| file.with_file_name(name));
    let known = tables.iter().filter(|path| path.is_file()).map(|path| {
        let table = measurements(path, lengths_or_positions, &mut Vec::new(), &session)?;
        Ok(table.holds(observations))
    });
    known.sum()
}

/// The last day of the parts of a measurement, and their temperature: of the robot, else of the air, else of the rows.
pub fn measured_conditions<'a>(
    parts: impl Iterator<Item = &'a Identity> + Clone,
    observations: &Measurements,
) -> MeasurementConditions {
    let temperature_c = parts.clone().find_map(temperature_c);
    MeasurementConditions {
        date: parts.filter_map(|identity| identity.measured.clone()).max(),
        temperature_c: temperature_c.or_else(|| observations.mean_temperature_c()),
    }
}

/// The conditions that a caller states of lengths in memory. The day may be after today: it may be that of a capture, whose
/// clock was ahead.
///
/// # Errors
/// The day is not a date, or the temperature is not plausible.
pub fn stated_conditions(
    measured: Option<String>,
    temperature_c: Option<f64>,
) -> Result<MeasurementConditions, Diagnostic> {
    let of_robot = |celsius| MeasuredTemperature { of: "robot".into(), celsius, u_k: None, device: None };
    let temperatures = temperature_c.map(of_robot).into_iter().collect();
    let identity = Identity { measured, temperatures, ..Identity::default() };
    identity.check_all().map_err(|(_, finding)| finding)?;
    Ok(MeasurementConditions { date: identity.measured, temperature_c })
}

fn temperature_c(identity: &Identity) -> Option<f64> {
    let of = |what: &str| identity.temperatures.iter().find(|found| found.of == what);
    of("robot").or_else(|| of("air")).map(|found| found.celsius)
}

/// Findings about the captures among the inputs.
fn run_findings(parts: &[InputPart], robot: &Robot) -> Vec<Diagnostic> {
    let runs = parts.iter().filter_map(|part| Some((part, part.matched.as_ref()?)));
    let in_part = |(part, matched): (&InputPart, &MatchedRun)| {
        // A run that other parts complete is not incomplete.
        let is_completed =
            parts.len() > 1 && matched.lost_poses().all(|pose| parts.iter().any(|of| of.has(&pose)));
        let findings = matched.findings(robot, is_completed).into_iter();
        // With one capture it is clear which capture is meant.
        let file = (parts.len() > 1).then(|| part.path.display().to_string());
        findings.map(move |finding| match &file {
            Some(file) => finding.in_file(file),
            None => finding,
        })
    };
    runs.flat_map(in_part).collect()
}

/// Whether the axis angles of all parts were measured or given.
fn angle_source(parts: &[InputPart]) -> AngleSource {
    let commanded = |part: &InputPart| {
        part.matched.as_ref().is_some_and(|matched| matched.axes() == AngleSource::Commanded)
    };
    if parts.iter().any(commanded) { AngleSource::Commanded } else { AngleSource::Given }
}

/// The finding if the bar of a table was warm or cold and nothing states that its lengths are referred to its
/// certificate.
fn uncorrected_bar(observations: &Measurements, bar: &BarIdentity) -> Option<IdentityFinding> {
    let lengths = observations.rows.iter().filter(|row| row.datum.bar().is_some());
    let longest_mm = lengths.map(|row| row.length_mm).reduce(f64::max)?;
    // An implausible temperature has a finding of its own.
    let mean_c = observations.mean_temperature_c().filter(|_| observations.warm().is_none())?;
    bar.uncorrected(bar.length_mm.unwrap_or(longest_mm), mean_c)
}

/// Reads the chain of a further table of measurements. Refuses another robot than in `lengths`; another bar or ball is
/// a finding.
fn read_further(
    path: &Path,
    lengths: &TracedArtefact,
    findings: &mut Vec<Diagnostic>,
) -> Result<TracedArtefact, Diagnostic> {
    let name = path.display().to_string();
    let (table, changed) = crate::artefact::of_table(ArtefactRole::Measurements, path)?;
    findings.extend(changed);
    check_one_set_up(&name, lengths, &table, findings)?;
    Ok(table)
}

/// Refuses a part of another robot than the first, and one whose lengths are there already; another bar or ball is a
/// finding.
fn check_further(
    part: &InputPart,
    others: &[InputPart],
    findings: &mut Vec<Diagnostic>,
) -> Result<(), Diagnostic> {
    let name = part.path.display().to_string();
    if part.measurements.rows.iter().any(|row| row.datum.bar().is_none()) {
        return Err(Diagnostic::file(&name, EstimationFinding::PartOfPositions));
    }
    if let Some(other) = others.iter().find(|other| part.counts_twice(other)) {
        let other = other.lengths.artefact.to_string();
        return Err(Diagnostic::file(&name, EstimationFinding::PartTwice { other }));
    }
    let Some(first) = others.first() else { return Ok(()) };
    if let Some(robot) = first.lengths.robot() {
        part.lengths.check_made_for(robot).map_err(|other| Diagnostic::file(&name, other))?;
    }
    check_one_set_up(&name, &first.lengths, &part.lengths, findings)
}

fn check_one_set_up(
    name: &str,
    lengths: &TracedArtefact,
    table: &TracedArtefact,
    findings: &mut Vec<Diagnostic>,
) -> Result<(), Diagnostic> {
    one_robot([(lengths.artefact.name.clone(), lengths), (name.to_owned(), table)])?;
    let others = lengths.provenance.identity.contradictions(&table.provenance.identity).into_iter();
    let is_set_up = |key: &str| key == BarIdentity::SERIAL || key.starts_with(Identity::BALLS);
    let others = others.filter(|other| is_set_up(&other.key));
    findings.extend(others.map(|Contradiction { key, known, stated }| {
        Diagnostic::file(name, ProvenanceFinding::OtherSetUp { key, known, stated })
    }));
    Ok(())
}

/// Reads positions that are given beside lengths.
fn read_positions(
    path: &Path,
    robot: &Robot,
    findings: &mut Vec<Diagnostic>,
    session: &RequestSession<'_>,
) -> Result<Measurements, Diagnostic> {
    let name = path.display().to_string();
    let positions = measurements(path, Measurements::positions_from_table, findings, session)?;
    let positions =
        positions.carrying(&robot.geometry.load).map_err(|finding| Diagnostic::file(&name, finding))?;
    check_measurements(&name, &positions, robot, &[])?;
    let of_positions = measurement_findings(&name, &positions, robot, &[]).into_iter();
    findings.extend(of_positions.filter(|finding| finding.severity() != Severity::Info));
    Ok(positions)
}

fn with_positions(
    lengths: Measurements,
    positions: Option<&Measurements>,
) -> Result<Measurements, Diagnostic> {
    match positions {
        Some(positions) => Ok(lengths.and(positions)?),
        None => Ok(lengths),
    }
}

/// The robot of the request, else the robot of the run's plan. Refuses another robot than the one of the lengths.
fn read_robot(
    named: Option<&RobotName>,
    run: Option<&RecordedRun>,
    lengths: &TracedArtefact,
    session: &RequestSession<'_>,
) -> Result<LoadedRobot, Diagnostic> {
    let read = match (named, run) {
        (Some(name), _) => robot_for_measurement(name, session)?,
        (None, Some(run)) => {
            let robot = run.robot()?;
            // A plan without a chain still has its robot.
            let recorded = lengths.robot().map(|robot| TracedArtefact::from(robot.clone()));
            let source = recorded.unwrap_or_else(|| robot.traced(&run.plan.header.robot));
            return Ok(LoadedRobot { source, robot, findings: Vec::new() });
        }
        (None, None) => return Err(EstimationFinding::NoRobot.into()),
    };
    let given = &read.source;
    if let Some(planned) = lengths.robot()
        && planned.differs(&given.artefact) == Some(ArtefactDifference::Serial)
    {
        return Err(lengths.of_another_robot(planned, &given.artefact).into());
    }
    one_robot([(lengths.artefact.name.clone(), lengths), (given.artefact.name.clone(), given)])?;
    if given.provenance.has(&lengths.artefact) {
        let (lengths, robot) = (lengths.artefact.to_string(), given.artefact.to_string());
        session.finding(ProvenanceFinding::UsedBefore { lengths, robot });
    } else {
        session.findings(lengths.other_calibration_than(given));
    }
    Ok(read)
}
