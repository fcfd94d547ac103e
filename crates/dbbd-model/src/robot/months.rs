//! How the uncertainty of a robot grows in the months after its identification.
//!
//! Twists, links and gear errors stay, except for the expansion of the links. The zeros of the joints, the tool ball
//! and the base balls wander: each month adds the same variance. When the posterior of a robot becomes the prior of a
//! later estimate, this is the only place that widens it.

use super::{AXES, Coordinate, Drift, Joint, MeasurementConditions, ParamId, Robot, RobotFinding};
use crate::base::date::{self, months_between};

/// Standard deviation of the step of a tool ball in use, mm for a month: as much as its seat repeats.
const TOOL_MM: f64 = 0.01;
/// Standard deviation of the step of a base ball with its stand on the floor of a hall, mm for a month.
const BASE_BALL_MM: f64 = 0.02;
/// Expansion of iron and steel, 1/K, and its relative standard uncertainty for an arm that is of aluminium in parts.
const EXPANSION_PER_K: f64 = 12e-6;
const EXPANSION_U: f64 = 0.3;
/// A hall is this much warmer in summer, and colder in winter, than in the mean, K.
const SEASON_K: f64 = 5.0;
const MONTHS_OF_YEAR: f64 = 12.0;

/// Steps of several parameters together, mm or rad: one standard deviation of each.
type JointStep = Vec<(ParamId, f64)>;

impl Robot {
    /// A finding if a day is before the robot's calibration, or too long after it.
    pub fn far_day(&self, day: &str) -> Option<RobotFinding> {
        let measured = self.measured.date.as_deref()?;
        let months = months_between(measured, day)?;
        let (day, measured) = (day.to_owned(), measured.to_owned());
        if months < 0.0 {
            return Some(RobotFinding::BeforeCalibration { day, measured });
        }
        let years = months / MONTHS_OF_YEAR;
        (months > Drift::MAX_MONTHS).then_some(RobotFinding::LongAfterCalibration { day, measured, years })
    }

    /// The robot with its uncertainty under the conditions of a later or earlier measurement. Where both temperatures
    /// are known, the links have grown by their difference. The day is taken over; without a date on both sides the
    /// robot stays as it is.
    #[must_use]
    pub fn under(&self, then: &MeasurementConditions) -> Self {
        let MeasurementConditions { date, temperature_c } = &self.measured;
        let Some(months) = date.as_deref().zip(then.date.as_deref()).and_then(|(a, b)| months_between(a, b))
        else {
            return self.clone();
        };
        let warmer_k = temperature_c.zip(then.temperature_c).map(|(here, there)| there - here);
        let unknown_k = warmer_k.map_or_else(|| season_k(months), |k| EXPANSION_U * k.abs());
        let mut later = self.widened(months.abs(), unknown_k);
        later.expand(EXPANSION_PER_K * warmer_k.unwrap_or(0.0));
        Self { measured: then.clone(), ..later }
    }

    /// The robot with its uncertainty this many months later, at a temperature that nobody knows yet.
    #[must_use]
    pub fn after_months(&self, months: f64) -> Self {
        let date = self.measured.date.as_deref().and_then(|day| date::after_months(day, months));
        let measured = MeasurementConditions { date, temperature_c: None };
        Self { measured, ..self.widened(months, season_k(months)) }
    }

    /// Lets all links grow by this share of their length.
    fn expand(&mut self, share: f64) {
        for (joint, row) in Joint::ALL.into_iter().zip(self.geometry.rows) {
            for (id, mm) in [(ParamId::A(joint), share * row.a), (ParamId::D(joint), share * row.d)] {
                if let Some(value) = self.geometry.value_mut(id) {
                    *value += mm;
                }
                self.posterior.iter_mut().for_each(|known| known.shift(id, mm));
            }
        }
    }

    /// The robot after steps of this many months, at a temperature that is uncertain by `kelvin`.
    pub(crate) fn widened(&self, months: f64, kelvin: f64) -> Self {
        let steps = self.steps(months, kelvin);
        let mut later = self.clone();
        later.drift.since_months += months;
        if let Some(known) = &mut later.posterior {
            known.widen(&steps);
        }
        if let Some(unknown) = &mut later.uncertainty {
            unknown.widen(&steps);
        }
        later
    }

    /// Independent steps that may have happened in this many months, with a temperature that is uncertain by `kelvin`.
    fn steps(&self, months: f64, kelvin: f64) -> Vec<JointStep> {
        let walk = months.sqrt();
        let zeros = Joint::ALL.map(|joint| vec![(ParamId::Theta(joint), self.drift.rms_zero_rad() * walk)]);
        let tool = Coordinate::ALL.map(|axis| vec![(ParamId::Tool(axis), TOOL_MM * walk)]);
        let of_posterior = self.posterior.iter().flat_map(|known| known.all_ids());
        let balls = of_posterior.filter(|id| matches!(id, ParamId::Ball(..)));
        let balls = balls.map(|id| vec![(*id, BASE_BALL_MM * walk)]);
        let growth = EXPANSION_PER_K * kelvin;
        let links = (0..AXES).flat_map(|at| {
            let (joint, row) = (Joint::ALL[at], &self.geometry.rows[at]);
            [(ParamId::A(joint), growth * row.a), (ParamId::D(joint), growth * row.d)]
        });
        zeros.into_iter().chain(tool).chain(balls).chain([links.collect()]).collect()
    }
}

/// Standard deviation of the temperature difference between two days in a hall where nobody measured it, K: for a
/// yearly wave of amplitude S and any phase it is S (1 - cos)^(1/2) of the time between the days. It does not fall
/// after half a year: no year is like another.
pub(crate) fn season_k(months: f64) -> f64 {
    let turn = std::f64::consts::TAU * (months.abs() / MONTHS_OF_YEAR).min(0.5);
    SEASON_K * (1.0 - turn.cos()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotPosterior;
    use nalgebra::DMatrix;

    fn identified(ids: &[ParamId], sd: f64) -> Robot {
        let mut robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let root = DMatrix::identity(ids.len(), ids.len()) * sd;
        robot.posterior = RobotPosterior::new(ids, &robot.geometry, &root);
        robot.uncertainty =
            Some(Box::new(crate::robot::RobotUncertainty { root, ..robot.known_uncertainty() }));
        robot.measured.date = Some("2026-01-31".into());
        robot
    }

    fn conditions(date: &str, temperature_c: Option<f64>) -> MeasurementConditions {
        MeasurementConditions { date: Some(date.into()), temperature_c }
    }

    /// Computed by hand: 20 urad a year with a factor of e (54.366 urad); in two years (730 days of 365.25 / 12 a
    /// month) 2^(1/2) of it. The second arm of 850 mm grows by 12e-6 / K; two days half a year apart in a season of 5 K
    /// differ by 5 * 2^(1/2) K.
    #[test]
    fn what_is_known_of_zeros_tool_and_links_grows_with_the_months() {
        let ids = [ParamId::Theta(Joint::J3), ParamId::Alpha(Joint::J3), ParamId::A(Joint::J3)];
        let robot = identified(&ids, 1e-6);
        let later = robot.under(&conditions("2028-01-31T08:00:00Z", None));
        let years = 730.0 / 365.25f64;
        let zero = (54.365_636e-6f64.powi(2) * years + 1e-12).sqrt();
        let arm = (850.0 * 12e-6 * 5.0 * 2f64.sqrt()).hypot(1e-6);
        let known = later.posterior.as_ref().unwrap();
        for (id, expected) in ids.into_iter().zip([zero, 1e-6, arm]) {
            let found = known.sd(id).unwrap();
            assert!((found / expected - 1.0).abs() < 1e-6, "{id}: {found} {expected}");
        }
        // Prior and prediction see the same.
        let unknown = later.known_uncertainty();
        let by_file = &unknown.root * unknown.root.transpose();
        let root = known.root_of(&ids);
        assert!((by_file - &root * root.transpose()).norm() < 1e-12);
        // The values stay, and the posterior is still that of this robot.
        assert!(later.geometry == robot.geometry && known.is_of(&later.geometry));
    }

    /// 850 mm grow by 12e-6 / K in 15 K, known to three tenths of it; the links share their temperature: the rest is one error.
    #[test]
    fn links_expand_together_by_the_temperature_that_was_measured() {
        let ids = [ParamId::A(Joint::J3), ParamId::D(Joint::J4)];
        let mut robot = identified(&ids, 1e-9);
        robot.measured.temperature_c = Some(18.0);
        let later = robot.under(&conditions("2026-02-01", Some(33.0)));
        let grown = 850.0 * 12e-6 * 15.0;
        let found = later.geometry.value(ids[0]).unwrap() - robot.geometry.value(ids[0]).unwrap();
        assert!((found - grown).abs() < 1e-9, "{found}");
        let known = later.posterior.as_ref().unwrap();
        assert!(known.is_of(&later.geometry));
        let root = known.root_of(&ids);
        let covariance = &root * root.transpose();
        assert!((covariance[(0, 0)].sqrt() / (0.3 * grown) - 1.0).abs() < 1e-6);
        let correlation = covariance[(0, 1)] / (covariance[(0, 0)] * covariance[(1, 1)]).sqrt();
        assert!((correlation.abs() - 1.0).abs() < 1e-6, "{correlation}");
    }

    #[test]
    fn a_day_before_the_calibration_or_ten_years_later_is_a_warning() {
        let robot = identified(&[ParamId::Theta(Joint::J3)], 1e-6);
        assert!(matches!(robot.far_day("2026-01-30"), Some(RobotFinding::BeforeCalibration { .. })));
        assert!(robot.far_day("2026-01-31").is_none() && robot.far_day("2035-12-31").is_none());
        match robot.far_day("2036-03-01") {
            Some(RobotFinding::LongAfterCalibration { years, .. }) => {
                assert!((years - 10.08).abs() < 0.02, "{years}");
            }
            other => panic!("{other:?}"),
        }
        let undated = Robot { measured: MeasurementConditions::default(), ..robot };
        assert!(undated.far_day("1990-01-01").is_none());
    }

    #[test]
    fn without_a_date_on_both_sides_or_a_day_later_nothing_is_widened() {
        let ids = [ParamId::Theta(Joint::J3), ParamId::A(Joint::J3)];
        let robot = identified(&ids, 1e-6);
        assert_eq!(robot.under(&MeasurementConditions::default()), robot);
        let undated = Robot { measured: MeasurementConditions::default(), ..robot.clone() };
        assert_eq!(undated.under(&conditions("2030-01-01", None)), undated);
        let same_day = robot.under(&conditions("2026-01-31", None)).posterior.unwrap();
        assert!((same_day.sd(ids[0]).unwrap() - 1e-6).abs() < 1e-18);
        // Earlier lengths are as far away as later ones.
        let [before, after] = ["2026-01-01", "2026-03-02"]
            .map(|date| robot.under(&conditions(date, None)).posterior.unwrap().sd(ids[0]).unwrap());
        assert!((before - after).abs() < 1e-15 && before > 1e-5);
    }

    /// 5 K in summer and winter: two days of any phase differ by 5 K in the root mean square of a quarter, and by 2^(1/2) * 5 K of
    /// half a year.
    #[test]
    fn seasons_differ_most_in_half_a_year() {
        for (months, expected) in [(0.0, 0.0), (3.0, 5.0), (6.0, 50f64.sqrt()), (12.0, 50f64.sqrt())] {
            assert!((season_k(months) - expected).abs() < 1e-12, "{months}");
        }
    }
}
