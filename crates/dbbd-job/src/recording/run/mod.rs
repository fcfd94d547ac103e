//! A recorded run: a capture with its plan, read once, and its results: lengths at poses, circles.

mod circles;
mod open;
mod plan_files;
mod temperature;

use std::path::Path;
use std::sync::Arc;

pub use circles::{MeasuredCircle, MeasuredCircles, drives};
pub use open::{MAX_COMPARED, damages, is_capture, losses, losses_at_end, open_run};
pub use plan_files::{ATTACHED_IDENTITY, PlanFiles, attached_plan, identity, read_plan, sources, unread};
use temperature::SampleTemperatures;

use super::axes::AxisTrack;
use super::matching::{
    self, ExpectedLengths, MarkerFit, MatchingInput, MeasuredAxes, PoseMatching, PoseOutcome, PublishedAxes,
};
use super::mounting;
use super::reports::DwellReport;
use super::stream::SampleStream;
use super::strobe_decoder::has_strobe;
use crate::plan::Plan;
use crate::recording::RecordingFinding;
use crate::recording::matching::MatchingFinding;
use dbbd_device::port::PortFinding;
use dbbd_model::base::expansion::ThermalExpansion;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::{BallId, BaseBall, ContextColumn};
use dbbd_model::provenance::{
    self, Artefact, ArtefactRole, DataOrigin, Identity, Provenance, TracedArtefact,
};
use dbbd_model::robot::{AXES, Robot};

/// The content of a capture that is to be matched.
pub struct RecordedRun {
    /// The attached plan, unless another one was named. Its header holds the job with the base balls, and the robot.
    pub plan: Plan,
    pub stream: SampleStream,
    /// Temperature of the bar, if it was sent.
    temperatures: SampleTemperatures,
    pub reports: Vec<DwellReport>,
    /// The axes that the controller published, if they were recorded.
    pub track: Option<AxisTrack>,
    /// Whether data of the run were lost, or it may belong to another plan.
    pub has_warnings: bool,
    /// Axis angles reported over EthernetKRL; angles of a `.dat` take precedence.
    pub axes_deg: MeasuredAxes,
    /// Owner of the run, and when it was recorded.
    identity: Identity,
    /// Start of the recording by the clock of the host, ns since 1970.
    pub started: Option<u64>,
    /// Where its readings come from, if it is stated.
    origin: Option<DataOrigin>,
}

/// Lengths that a model predicts: evidence for the matching, like the times.
#[derive(Clone, Copy)]
pub struct PredictedLengths<'a> {
    /// Length in mm by base ball and axis angles in degrees.
    pub length_mm: &'a dyn Fn(BallId, &[f64; AXES]) -> f64,
    /// Standard deviation of a predicted length, mm.
    pub sigma_mm: f64,
}

impl RecordedRun {
    /// The measurements, with their lengths corrected by the bar's certificate for the temperature at which they were
    /// read.
    ///
    /// To use predicted lengths: match, identify, and match again until [`PoseMatching::same_pairs`] shows no change.
    ///
    /// # Errors
    /// The program belongs to another plan, or the reading runs against the motion.
    pub fn matching(&self, predicted: Option<PredictedLengths<'_>>) -> Result<PoseMatching, Diagnostic> {
        let expansion = self.bar_expansion();
        let warm = expansion.zip(self.temperatures.mean());
        let factor = warm.map_or(1.0, |(expansion, mean_c)| expansion.referred_mm(1.0, mean_c));
        // The alignment compares lengths as read.
        let mut matching = match predicted {
            Some(PredictedLengths { length_mm, sigma_mm }) => {
                let as_read = |ball: BallId, axes_deg: &[f64; AXES]| length_mm(ball, axes_deg) / factor;
                self.matching_as_read(Some(PredictedLengths { length_mm: &as_read, sigma_mm }))?
            }
            None => self.matching_as_read(None)?,
        };
        let readings = matching.outcomes.iter().filter_map(PoseOutcome::reading);
        let temperatures: Vec<_> = readings.map(|reading| self.temperature_at(reading.middle_s())).collect();
        if temperatures.iter().any(Option::is_some) {
            let observations = &mut matching.observations;
            observations.columns.push(ContextColumn::TemperatureC);
            for (row, temp_c) in observations.rows.iter_mut().zip(temperatures) {
                if let (Some(expansion), Some(temp_c)) = (expansion, temp_c) {
                    row.length_mm = expansion.referred_mm(row.length_mm, temp_c);
                }
                Arc::make_mut(row.context.get_or_insert_default()).temperature_c = temp_c;
            }
        }
        Ok(matching)
    }

    /// The measurements without a correction for temperature.
    ///
    /// # Errors
    /// The program belongs to another plan, or the reading runs against the motion.
    pub fn matching_as_read(
        &self,
        predicted: Option<PredictedLengths<'_>>,
    ) -> Result<PoseMatching, Diagnostic> {
        let axes_deg = (!self.axes_deg.is_empty()).then_some(&self.axes_deg);
        let lengths =
            predicted.map(|predicted| matching::expected_lengths(&self.plan, axes_deg, predicted.length_mm));
        let expected = lengths.as_deref().zip(predicted);
        let robot = self.robot().ok();
        let published = self.track.as_ref().zip(robot.as_ref());
        let mut matching = matching::match_poses(&MatchingInput {
            reports: &self.reports,
            expected: expected
                .map(|(length_mm, predicted)| ExpectedLengths { length_mm, sigma_mm: predicted.sigma_mm }),
            bar_sigma_mm: self.plan.header.job.bar.sigma_um * 1e-3,
            axes_deg,
            published: published
                .map(|(track, robot)| PublishedAxes { track, geometry: &robot.controller().geometry }),
            ..MatchingInput::new(&self.plan, &self.stream)
        });
        if let Some(module) = matching.code.foreign_module() {
            return Err(MatchingFinding::ForeignProgram { module }.into());
        }
        let repeatability_mm = robot.as_ref().and_then(|robot| robot.controller().repeatability_mm);
        let markers = MarkerFit::seen(&self.plan, &self.stream, &matching);
        let settle_s = self.plan.header.job.motion.settle_s;
        matching.findings.extend(markers.and_then(|markers| markers.late(settle_s)));
        match markers.and_then(|markers| markers.finding(repeatability_mm)) {
            Some(inverted @ MatchingFinding::ReadingInverted { .. }) => Err(inverted.into()),
            scaled => {
                matching.findings.extend(scaled);
                Ok(matching)
            }
        }
    }

    /// The correction of a length for temperature; `None` if the job gives no expansion of the bar.
    pub fn bar_expansion(&self) -> Option<ThermalExpansion> {
        self.plan.header.job.identity().bar.expansion()
    }

    /// Temperature of the bar at a time of the stream, degrees Celsius.
    pub fn temperature_at(&self, t_s: f64) -> Option<f64> {
        self.temperatures.at(self.stream.at(t_s))
    }

    /// Findings of the mounting monitor: the largest of each kind. Only readings at rest count, which needs a strobe:
    /// in motion, backlash of a joint makes jumps.
    pub fn mounting(&self) -> Vec<PortFinding> {
        if !(self.reports.is_empty() && has_strobe(&self.stream)) {
            return Vec::new();
        }
        let expected = mounting::ExpectedMounting::unplanned(self.plan.header.job.bar.sigma_um);
        mounting::worst(expected, &self.stream, self.plan.header.job.bar.stroke_mm)
    }

    /// The finding about the correction for temperature.
    fn temperature_finding(&self) -> Option<Diagnostic> {
        let length_mm = self.plan.header.job.bar.length_mm;
        match (self.bar_expansion(), self.temperatures.mean()) {
            (Some(expansion), Some(mean_c)) => {
                let correction_um = 1e3 * (expansion.referred_mm(length_mm, mean_c) - length_mm);
                Some(RecordingFinding::TemperatureCorrected { mean_c, correction_um, length_mm }.into())
            }
            (Some(_), None) => Some(RecordingFinding::TemperatureUnknown.into()),
            (None, Some(mean_c)) => {
                self.plan.header.job.identity().bar.uncorrected(length_mm, mean_c).map(Diagnostic::from)
            }
            (None, None) => None,
        }
    }

    /// The capture at `path` as an artefact of its plan.
    pub fn traced(&self, path: &Path) -> Result<TracedArtefact, Diagnostic> {
        let artefact =
            Artefact { origin: self.origin, ..crate::artefact::of_file(ArtefactRole::Capture, path)? };
        let mut identity = self.identity.clone();
        if let Some(celsius) = self.temperatures.mean()
            && identity.temperatures.iter().all(|stated| stated.of != "bar")
        {
            let device = Some("its own sensor".into());
            identity.temperatures.push(provenance::MeasuredTemperature {
                of: "bar".into(),
                celsius,
                u_k: None,
                device,
            });
        }
        Ok(TracedArtefact {
            artefact,
            provenance: Provenance { identity, ..crate::artefact::made_from([&self.plan.traced()?]) },
        })
    }

    pub fn centres(&self) -> Vec<BaseBall> {
        self.plan.header.job.balls()
    }

    /// The robot that the plan was made for.
    pub fn robot(&self) -> Result<Robot, Diagnostic> {
        Robot::from_toml("the plan's robot", &self.plan.header.robot)
    }
}
