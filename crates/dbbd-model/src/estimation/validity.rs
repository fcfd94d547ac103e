//! The validity of a calibration: for which tool and payload it holds, until when, and with what uncertainty.

use std::fmt;

use super::result::{DriftBasis, MapPoint, PayloadUncertainty, Validity};
use super::{Positions, Workspace};
use crate::base::date;
use crate::math::distributions::COVERAGE_FACTOR;
use crate::measurement::ApproachedPose;
use crate::robot::{Payload, Robot, season_k};

/// Number and seed of the poses over which the growth of the uncertainty is taken, uniform within the axis limits.
const POSES: usize = 300;
const SEED: u64 = 1;
/// Characters of a day without its time, as in 2026-03-01.
const DAY: usize = 10;
/// Resolution of the time that is sought, months.
const MONTHS_RESOLUTION: f64 = 0.02;

/// What ends the validity of a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ValidityLimit {
    /// The user's tolerance for the expanded uncertainty, mm.
    Tolerance(f64),
    /// So many times the expanded uncertainty of today.
    Growth(f64),
}

impl Validity {
    /// No calibration is valid for longer, months: a year is the usual interval between calibrations of measuring equipment, and
    /// no drift foretells a collision.
    pub const LONGEST_MONTHS: f64 = 12.0;

    /// The validity of a robot's calibration until a limit, which only a tolerance gives: without it there is the uncertainty
    /// with its day. `map` is the predicted position uncertainty today; it grows with the drift of the months to come. `None`
    /// without a posterior, or if the uncertainty is not finite.
    pub fn of(robot: &Robot, limit: Option<ValidityLimit>, map: &[MapPoint]) -> Option<Self> {
        if !robot.has_posterior() {
            return None;
        }
        let poses = Workspace::uniform(robot.controller(), POSES, SEED);
        let poses: Vec<ApproachedPose> = poses.iter().map(ApproachedPose::unapproached).collect();
        let mean_square = |robot: &Robot| {
            let positions = Positions::of(robot, &poses);
            (0..poses.len()).map(|pose| positions.sd_mm(pose).powi(2)).sum::<f64>() / poses.len() as f64
        };
        let (today, known) = (MapPoint::root_mean_square_mm(map).powi(2), mean_square(robot));
        // The steps of the months are independent of what is known, and of each other.
        let [by_month, by_square_kelvin] = [(1.0, 0.0), (0.0, 1.0)]
            .map(|(months, kelvin)| mean_square(&robot.widened(months, kelvin)) - known);
        let expanded = |months: f64| {
            let grown = months * by_month + season_k(months).powi(2) * by_square_kelvin;
            COVERAGE_FACTOR * (today + grown.max(0.0)).sqrt()
        };
        let now_mm = expanded(0.0);
        if !now_mm.is_finite() {
            return None;
        }
        let limit_mm = limit.map(|limit| match limit {
            ValidityLimit::Tolerance(mm) => mm,
            ValidityLimit::Growth(growth) => growth * now_mm,
        });
        let months = limit_mm.map(|limit_mm| crossing(limit_mm, now_mm, expanded));
        let measured = robot.measured.date.clone();
        let until = measured.as_deref().zip(months).and_then(|(day, months)| date::after_months(day, months));
        Some(Self {
            tool_mm: robot.geometry.tool.into(),
            payload_kg: robot.geometry.load.carried().map(|Payload { kg, .. }| *kg),
            measured,
            expanded_uncertainty_mm: now_mm,
            limit_mm,
            months,
            until,
            rated_payload: rated_payload(robot).map(|(rated, kg)| {
                let by_payload = mean_square(&rated) - known;
                let square = today + by_payload.max(0.0);
                PayloadUncertainty { kg, expanded_uncertainty_mm: COVERAGE_FACTOR * square.sqrt() }
            }),
            basis: if robot.drift.has_history() { DriftBasis::History } else { DriftBasis::HyperPrior },
        })
    }
}

/// The robot with the payload for which such an arm is made, and its mass, kg; `None` if it carried as much when it was measured.
fn rated_payload(robot: &Robot) -> Option<(Robot, f64)> {
    let load = &robot.geometry.load;
    let rated = load.rated(&robot.geometry.rows);
    let has_carried = |payload: &Payload| payload.is_measured && payload.kg >= rated.kg;
    if load.payloads.iter().any(has_carried) {
        return None;
    }
    let (mut robot, kg) = (robot.clone(), rated.kg);
    robot.geometry.load.payloads.insert(0, rated);
    Some((robot, kg))
}

/// The months until a growing uncertainty reaches a limit, at most [`Validity::LONGEST_MONTHS`].
fn crossing(limit_mm: f64, now_mm: f64, expanded_mm: impl Fn(f64) -> f64) -> f64 {
    if now_mm >= limit_mm {
        return 0.0;
    }
    let (mut before, mut after) = (0.0, Validity::LONGEST_MONTHS);
    if expanded_mm(after) < limit_mm {
        return after;
    }
    while after - before > MONTHS_RESOLUTION {
        let middle = 0.5 * (before + after);
        if expanded_mm(middle) < limit_mm { before = middle } else { after = middle }
    }
    before
}

impl Validity {
    /// The tool and the payload for which the calibration is valid.
    pub fn conditions(&self) -> String {
        let [x, y, z] = self.tool_mm;
        let payload = match self.payload_kg {
            Some(kg) => format!("up to {kg} kg"),
            None => "payload not stated".into(),
        };
        format!("for the tool at ({x:.1}, {y:.1}, {z:.1}) mm, {payload}")
    }

    /// The day of the measurements without its time, if it is known.
    pub fn day(&self) -> Option<&str> {
        let measured = self.measured.as_deref()?;
        Some(measured.get(..DAY).unwrap_or(measured))
    }
}

impl fmt::Display for Validity {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.conditions())?;
        match (&self.until, self.months) {
            (Some(until), _) => write!(out, ", until {until}")?,
            (None, Some(months)) => write!(out, ", for {months:.1} months")?,
            (None, None) => {}
        }
        let now_mm = self.expanded_uncertainty_mm;
        match (self.limit_mm, self.day()) {
            (Some(limit_mm), _) => {
                write!(out, ": U = {now_mm:.2} mm (k = 2) at first, at most {limit_mm:.2} mm until then")?
            }
            (None, Some(day)) => return write!(out, ": U = {now_mm:.2} mm (k = 2) on {day}"),
            (None, None) => return write!(out, ": U = {now_mm:.2} mm (k = 2) on the day of the measurement"),
        }
        match self.basis {
            DriftBasis::HyperPrior => {
                write!(out, "; the drift is assumed, this robot has no history of three runs")
            }
            DriftBasis::History => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Joint, MeasurementConditions, ParamId, RobotUncertainty};
    use nalgebra::DMatrix;

    /// An uncertainty that grows with the root of the months: 0.1 (1 + m)^(1/2) mm is 0.3 mm after 8 months.
    #[test]
    fn the_limit_is_reached_where_the_uncertainty_crosses_it() {
        let expanded = |months: f64| 0.1 * (1.0 + months).sqrt();
        let found = crossing(0.3, 0.1, expanded);
        assert!((found - 8.0).abs() <= MONTHS_RESOLUTION, "{found}");
        assert_eq!([crossing(0.1, 0.1, expanded), crossing(0.4, 0.1, expanded)], [0.0, 12.0]);
    }

    fn identified(sd_rad: f64) -> Robot {
        let mut robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let unknown = RobotUncertainty {
            parameters: vec![ParamId::Theta(Joint::J3)],
            root: DMatrix::from_element(1, 1, sd_rad),
            pose_mm: 0.0,
            ..robot.known_uncertainty()
        };
        robot.uncertainty = Some(Box::new(unknown));
        robot.measured = MeasurementConditions { date: Some("2026-03-01".into()), temperature_c: None };
        robot
    }

    /// A map of one point with the robot's uncertainty over the poses.
    fn map(robot: &Robot) -> [MapPoint; 1] {
        let poses = Workspace::uniform(robot.controller(), POSES, SEED);
        let poses: Vec<ApproachedPose> = poses.iter().map(ApproachedPose::unapproached).collect();
        let positions = Positions::of(robot, &poses);
        let square: f64 = (0..POSES).map(|pose| positions.sd_mm(pose).powi(2)).sum();
        [MapPoint { position: nalgebra::Vector3::zeros(), rms_mm: (square / POSES as f64).sqrt() }]
    }

    /// If only the zero of one joint is uncertain, U is proportional to its standard deviation: it has grown by half
    /// when the walk has added 1.25 times the variance, after 1.25 (s / rate)^2 months.
    #[test]
    fn it_holds_until_u_has_grown_to_its_limit() {
        let robot = identified(40e-6);
        let map = map(&robot);
        let found = Validity::of(&robot, Some(ValidityLimit::Growth(1.5)), &map).unwrap();
        assert!((found.expanded_uncertainty_mm / (2.0 * map[0].rms_mm) - 1.0).abs() < 1e-12);
        let months = 1.25 * (40e-6 / robot.drift.rms_zero_rad()).powi(2);
        assert!((found.months.unwrap() - months).abs() < 0.03, "{found:?} {months}");
        assert!((found.limit_mm.unwrap() / found.expanded_uncertainty_mm - 1.5).abs() < 1e-12);
        assert_eq!(found.until, date::after_months("2026-03-01", found.months.unwrap()));
        assert_eq!(found.basis, DriftBasis::HyperPrior);
        let same = Some(ValidityLimit::Tolerance(found.limit_mm.unwrap()));
        assert_eq!(Validity::of(&robot, same, &map).unwrap(), found);
        // A limit that is reached already, one that is far away, and none.
        let of = |limit| Validity::of(&robot, limit, &map).unwrap();
        assert_eq!(of(Some(ValidityLimit::Growth(1.0))).until.as_deref(), Some("2026-03-01"));
        assert_eq!(of(Some(ValidityLimit::Growth(1e3))).until.as_deref(), Some("2027-03-01"));
        let bare = of(None);
        assert_eq!((bare.limit_mm, bare.months, &bare.until), (None, None, &None));
        assert!(bare.to_string().ends_with("mm (k = 2) on 2026-03-01"), "{bare}");
        let at_noon = Validity { measured: Some("2026-03-01T12:00:00Z".into()), ..bare.clone() };
        assert_eq!(at_noon.to_string(), bare.to_string());
        // A better calibration is valid for as long or longer.
        let better = identified(30e-6);
        let tolerance = Some(ValidityLimit::Tolerance(found.limit_mm.unwrap()));
        let of_better = Validity::of(&better, tolerance, &self::map(&better)).unwrap();
        assert!(of_better.months.unwrap() > found.months.unwrap() && of_better.months.unwrap() <= 12.0);
        let undated = Robot { measured: MeasurementConditions::default(), ..robot.clone() };
        let undated = Validity::of(&undated, same, &map).unwrap();
        assert!(undated.until.is_none() && undated.months == found.months);
        let unknown = Robot { uncertainty: None, posterior: None, ..robot.clone() };
        assert!(Validity::of(&unknown, same, &map).is_none());
    }
}
