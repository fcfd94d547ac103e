//! A recorded run: a capture with its plan, read once, and what becomes of the two: lengths at poses, circles.

mod circles;
mod open;
mod temperature;

use std::collections::BTreeMap;

pub use circles::Circle;
pub use open::{is_capture, open, plan_beside};
use temperature::{Temperatures, certificate};

use crate::circular::Temperature;
use crate::diag::Diagnostic;
use crate::model::{AXES, Centre, Further, Robot};
use crate::plan::Plan;
use crate::sync::{self, Expected, Fate, Input, Report, Stream, Synced};

/// What is to be said while a run is read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Note {
    /// The user must see it.
    Warning(String),
    /// What was done.
    Remark(String),
}

/// What a capture gives to be joined.
pub struct Run {
    /// The plan: the one attached, unless another one was named. Its header holds the job with
    /// the base balls, and the robot.
    pub plan: Plan,
    /// The samples on one clock.
    pub stream: Stream,
    /// The bar's temperature, where it was told.
    temperatures: Temperatures,
    /// What the controller reported.
    pub reports: Vec<Report>,
    /// Whether something of the run was lost: a damage, a cut end, samples lost on the way to the disk.
    pub torn: bool,
    /// Axis angles (degrees) that the program measured, by the plan's index: as it told them over EthernetKRL, and
    /// those of a `.dat` before these.
    pub axes_deg: BTreeMap<u32, [f64; AXES]>,
}

impl Run {
    /// The observations, with their lengths referred by the bar's certificate to the temperature that they
    /// were read at. With a `model` of the lengths and their standard deviation (mm) it speaks in the
    /// alignment as well: it is given the number of the base ball and the axis angles in degrees.
    ///
    /// To align, identify and align again until [`Synced::same_pairs`] says that nothing changed.
    pub fn observations<F>(&self, model: Option<(F, f64)>) -> Synced
    where
        F: Fn(usize, &[f64; AXES]) -> f64,
    {
        let certificate = self.certificate();
        let warm = certificate.zip(self.temperatures.mean());
        let factor = warm.map_or(1.0, |(certificate, mean_c)| certificate.referred_mm(1.0, mean_c));
        // Readings are aligned as they were read.
        let mut synced = self.measured(model.map(|(length_mm, sigma_mm)| {
            (move |centre: usize, axes_deg: &[f64; AXES]| length_mm(centre, axes_deg) / factor, sigma_mm)
        }));
        let dwells = synced.fates.iter().filter_map(|pose| match &pose.fate {
            Fate::Matched { dwell, .. } => Some(0.5 * (dwell.from_s + dwell.to_s)),
            _ => None,
        });
        let temperatures: Vec<_> = dwells.map(|t_s| self.temperature_at(t_s)).collect();
        if temperatures.iter().any(Option::is_some) {
            let observations = &mut synced.observations;
            let before = std::mem::take(&mut observations.further);
            let names = before.columns.iter().map(String::as_str).chain(["temp_c"]);
            observations.further = Further::new(names);
            for (row, temp_c) in observations.rows.iter_mut().zip(temperatures) {
                if let (Some(certificate), Some(temp_c)) = (certificate, temp_c) {
                    row.length_mm = certificate.referred_mm(row.length_mm, temp_c);
                }
                let mut cells = before.cells(row.further);
                cells.push(temp_c.map_or(String::new(), |c| format!("{c:.2}")));
                row.further = observations.further.add(cells);
            }
        }
        synced
    }

    /// The observations as read.
    pub fn measured<F>(&self, model: Option<(F, f64)>) -> Synced
    where
        F: Fn(usize, &[f64; AXES]) -> f64,
    {
        let axes_deg = (!self.axes_deg.is_empty()).then_some(&self.axes_deg);
        let lengths = model
            .map(|(length_mm, sigma_mm)| (sync::expected_lengths(&self.plan, axes_deg, length_mm), sigma_mm));
        sync::observations(&Input {
            reports: &self.reports,
            expected: lengths
                .as_ref()
                .map(|(length_mm, sigma_mm)| Expected { length_mm, sigma_mm: *sigma_mm }),
            bar_sigma_mm: self.plan.header.job.bar.sigma_um * 1e-3,
            axes_deg,
            ..Input::new(&self.plan, &self.stream)
        })
    }

    /// How the bar's certificate refers a length; `None` where it gives no expansion.
    pub fn certificate(&self) -> Option<Temperature> {
        certificate(&self.plan.header.job)
    }

    /// The bar's temperature at a time of the run, degrees Celsius.
    pub fn temperature_at(&self, t_s: f64) -> Option<f64> {
        self.temperatures.at(self.stream.at(t_s))
    }

    /// What was done about temperature, for the user.
    fn temperature_note(&self) -> Option<String> {
        let bar = &self.plan.header.job.bar;
        match (self.certificate(), self.temperatures.mean()) {
            (Some(certificate), Some(mean_c)) => {
                let more_um = 1e3 * (certificate.referred_mm(bar.length_mm, mean_c) - bar.length_mm);
                Some(format!(
                    "bar at {mean_c:.1} degrees: lengths are corrected by its certificate ({more_um:+.1} um at {} mm)",
                    bar.length_mm
                ))
            }
            (Some(_), None) => {
                Some("no temperature of the bar was recorded: lengths are not corrected for it".into())
            }
            (None, _) => None,
        }
    }

    /// The observations by their times alone.
    pub fn timed(&self) -> Synced {
        self.observations(None::<(fn(usize, &[f64; AXES]) -> f64, f64)>)
    }

    /// The base balls of the job.
    pub fn centres(&self) -> Vec<Centre> {
        let balls = &self.plan.header.job.centres;
        balls.iter().map(|ball| Centre { id: ball.id as usize, position: ball.xyz_mm.into() }).collect()
    }

    /// The robot that the plan was made for.
    ///
    /// # Errors
    /// What is wrong in its text.
    pub fn robot(&self) -> Result<Robot, Diagnostic> {
        Robot::from_toml("the plan's robot", &self.plan.header.robot)
    }
}
