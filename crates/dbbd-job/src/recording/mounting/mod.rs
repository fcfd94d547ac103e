//! Detects faults of the mounting of a bar, from its readings alone and as the faults happen.
//!
//! Readings are averaged over 5 ms. A jump is the mismatch of two straight lines, through the 40 ms before and
//! after a moment. While the robot rests, the scatter of means over 50 ms about a straight line, its slope and its
//! roughness show everything slower. Thresholds follow from the noise of a reading, the rate, and the speed of the
//! reading that the plan allows: `docs/explanation/mounting.md`.

mod monitor;
mod still;

use std::collections::BTreeMap;

use super::stream::SampleStream;
use crate::plan::Plan;
use crate::plan::timing::MARKER_MM_S;
use dbbd_device::port::PortFinding;
pub use monitor::MountingMonitor;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MountingFault {
    NotSeated,
    Creep,
    Slip,
    CablePull,
    Moved,
    /// The bar is out of its stroke, or off, while the robot measures.
    OutOfStroke,
}

/// A detected fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectedFault {
    pub fault: MountingFault,
    /// Time, s.
    pub t_s: f64,
    /// Height, mm; for a creep its rate, mm/s; for a bar out of its stroke the number of dwells so far.
    pub size: f64,
}

/// The condition under which the robot is known to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RestCondition {
    /// No program runs, until a strobe shows one.
    Standing,
    /// A program starts: at rest from the mounting of the bar to the first strobe, and while the strobe is high.
    /// Unknown without a strobe.
    Program,
    /// A program may be running: at rest while the strobe is high, until the bar is taken off.
    UnderWay,
}

/// The readings that are expected of a well-mounted bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedMounting {
    /// Standard deviation of a reading, mm.
    pub noise_mm: f64,
    /// Largest speed of the reading while the robot moves, mm/s; it may stop at once.
    pub speed_mm_s: f64,
    pub rest: RestCondition,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MountedReading {
    /// Time, s.
    pub t_s: f64,
    pub reading_mm: f64,
    /// Whether the reading is valid and within the stroke.
    pub mounted: bool,
    pub strobe: Option<bool>,
}

/// State of the mounting, for the operator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MountingState {
    /// The bar is not between its balls.
    #[default]
    Off,
    /// The bar moves more than a mounted bar does: hands are on it.
    Handled,
    /// The bar has been at rest for less than a second.
    Settling,
    Stable,
    /// The robot moves, or may move.
    Moving,
}

impl MountingState {
    pub fn name(self) -> &'static str {
        match self {
            MountingState::Off => "off",
            MountingState::Handled => "handled",
            MountingState::Settling => "settling",
            MountingState::Stable => "stable",
            MountingState::Moving => "moving",
        }
    }
}

impl ExpectedMounting {
    /// The expectation for a bar that is read without a run.
    pub fn standing(sigma_um: f64) -> Self {
        Self { noise_mm: 1e-3 * sigma_um, speed_mm_s: f64::INFINITY, rest: RestCondition::Standing }
    }

    /// The expectation for unknown motion of the robot: jumps are detected at rest only.
    pub fn unplanned(sigma_um: f64) -> Self {
        Self { noise_mm: 1e-3 * sigma_um, speed_mm_s: f64::INFINITY, rest: RestCondition::Program }
    }

    /// The expectation for a robot that follows a plan. The reading changes with the feed across a bar whose ball is
    /// off by at most half a stroke, and with the sync markers.
    pub fn of(plan: &Plan, rest: RestCondition) -> Self {
        let job = &plan.header.job;
        let [low_mm, high_mm] = job.bar.stroke_mm;
        let off = 0.5 * (high_mm - low_mm) / job.bar.length_mm;
        let speed_mm_s = job.motion.feed_mm_s * off + MARKER_MM_S;
        Self { noise_mm: 1e-3 * job.bar.sigma_um, speed_mm_s, rest }
    }

    /// The same expectation, with the resolution of the bar as the least noise.
    pub fn with_resolution(self, resolution_mm: f64) -> Self {
        Self { noise_mm: self.noise_mm.max(resolution_mm), ..self }
    }
}

/// The faults of a recorded run with a bar of this stroke (mm): the largest fault of each kind.
pub fn worst(
    expected: ExpectedMounting,
    stream: &SampleStream,
    [low_mm, high_mm]: [f64; 2],
) -> Vec<PortFinding> {
    let mut monitor = MountingMonitor::new(expected);
    let mut worst: BTreeMap<MountingFault, DetectedFault> = BTreeMap::new();
    for at in 0..stream.len() {
        let reading_mm = stream.reading_mm[at];
        let mounted = stream.valid(at) && (low_mm..=high_mm).contains(&reading_mm);
        let read = MountedReading { t_s: stream.t_s[at], reading_mm, mounted, strobe: stream.strobe(at) };
        let Some(named) = monitor.push(read) else { continue };
        let known = worst.entry(named.fault).or_insert(named);
        if named.size.abs() > known.size.abs() {
            *known = named;
        }
    }
    if let Some(out) = worst.get_mut(&MountingFault::OutOfStroke) {
        // A bar that leaves its stroke explains whatever else it seems to do.
        out.size = f64::from(monitor.out_of_stroke());
        return vec![out.finding()];
    }
    worst.values().map(DetectedFault::finding).collect()
}

impl DetectedFault {
    pub fn finding(&self) -> PortFinding {
        let size_um = 1e3 * self.size;
        match self.fault {
            MountingFault::NotSeated => PortFinding::NotSeated { rocks_um: size_um },
            MountingFault::Creep => PortFinding::BallCreeps { rate_um_s: size_um },
            MountingFault::Slip => PortFinding::MagnetSlipped { jump_um: size_um },
            MountingFault::CablePull => PortFinding::CablePulls { change_um: size_um },
            MountingFault::Moved => PortFinding::BallMoved { jump_um: size_um },
            MountingFault::OutOfStroke => PortFinding::OutOfStroke { dwells: self.size },
        }
    }
}

#[cfg(test)]
mod tests {
    use dbbd_model::diagnostic::Finding;

    use super::*;

    #[test]
    fn each_fault_is_reported_with_its_size_in_micrometres() {
        let finding = |fault| DetectedFault { fault, t_s: 1.0, size: 0.25 }.finding();
        for (fault, code, name) in [
            (MountingFault::NotSeated, "W0280", "rocks_um"),
            (MountingFault::Creep, "W0281", "rate_um_s"),
            (MountingFault::Slip, "W0282", "jump_um"),
            (MountingFault::CablePull, "W0283", "change_um"),
            (MountingFault::Moved, "W0284", "jump_um"),
        ] {
            assert_eq!(finding(fault).code().as_str(), code);
            assert_eq!(finding(fault).values()[name], 250.0);
        }
    }
}
