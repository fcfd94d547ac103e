//! Status and turn by KUKA's rules, ABB's quadrants and FANUC's CONFIG, which distinguish the branches and turns of one
//! pose; and the distance from singular positions.

use std::f64::consts::TAU;
use std::fmt;
use std::str::FromStr;

use nalgebra::Matrix6;

use super::{Unsolved, branches, closed};
use crate::robot::pose::Pose;
use crate::robot::{AXES, Geometry, Robot, max_axis_difference};

/// An axis nearer to zero than this (1e-6 degrees) counts as zero.
const ZERO_RAD: f64 = 1e-6 * std::f64::consts::PI / 180.0;

/// The digits of a pose move an axis by less than this, rad (0.005 degrees).
const BORDER_RAD: f64 = 0.005 * std::f64::consts::PI / 180.0;

/// The distance of the wrist centre, where axes 5 and 6 meet, in front of axis 1: x in axis 1's frame, mm.
fn forward(geometry: &Geometry, axes: &[f64; AXES]) -> f64 {
    let [shoulder, .., wrist, _] = geometry.frames(&geometry.joint_angles(axes));
    shoulder.rotation.column(0).dot(&(wrist.position - shoulder.position))
}

/// The status bits of the branch at axis angles in rad, which are KUKA's: bit 0 wrist centre behind axis 1 (x < 0 in
/// axis 1's frame), bit 1 elbow (A3 at or above the angle at which the arm is stretched), bit 2 A5 < 0.
/// An arm without a closed form is stretched where the line of joint 4 goes on from the upper arm, and its bit 2 is a
/// negative determinant of the Jacobian.
pub fn status(geometry: &Geometry, axes: &[f64; AXES]) -> u8 {
    let behind = forward(geometry, axes) < 0.0;
    let (elbow, wrist) = match closed::ClosedFormArm::near(geometry) {
        Some(arm) => (arm.elbow(axes), arm.wrist(axes)),
        // Without a closed form: on which side of a singularity.
        None => {
            let joints = geometry.coupling.joints(axes);
            (closed::elbow(&geometry.rows, &joints), determinant(geometry, axes))
        }
    };
    u8::from(behind) | u8::from(elbow >= 0.0) << 1 | u8::from(wrist < -ZERO_RAD) << 2
}

/// The determinant of the Jacobian, which changes its sign at a singular position.
fn determinant(geometry: &Geometry, axes: &[f64; AXES]) -> f64 {
    let columns = geometry.axis_jacobian(axes);
    Matrix6::from_fn(|row, i| if row < 3 { columns[i].0[row] } else { columns[i].1[row - 3] }).determinant()
}

/// The distance of an arm from its singular positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SingularityClearance {
    /// Distance of the wrist: |A5| from straight or folded back, rad.
    pub wrist: f64,
    /// Distance of the elbow: angle between upper arm and forearm from stretched or folded, rad.
    pub elbow: f64,
    /// Distance of the shoulder: of the wrist centre from the plane through axis 1 that is square to the plane of the
    /// arm, mm.
    pub overhead: f64,
}

/// The distance of an arm from its singular positions at axis angles in rad; `None` for an arm that is not near one
/// with a closed form, because it has other singular positions.
pub fn clearance(geometry: &Geometry, axes: &[f64; AXES]) -> Option<SingularityClearance> {
    let arm = closed::ClosedFormArm::near(geometry)?;
    // Distance of an angle from the nearest multiple of half a turn.
    let from_straight = |angle: f64| angle.sin().abs().asin();
    Some(SingularityClearance {
        wrist: from_straight(arm.wrist(axes)),
        elbow: from_straight(arm.elbow(axes)),
        overhead: forward(geometry, axes).abs(),
    })
}

/// KUKA's turn bits: bit i is set when axis i + 1 is negative (an axis within 1e-6 deg of 0 is 0).
pub fn turn(axes: &[f64; AXES]) -> u8 {
    axes.iter().enumerate().fold(0, |bits, (i, angle)| bits | u8::from(*angle < -ZERO_RAD) << i)
}

/// The same pose with every axis turned fully as often as the robot's limits allow; empty when an
/// axis has no turn within them.
pub fn turns_within(axes: &[f64; AXES], robot: &Robot) -> Vec<[f64; AXES]> {
    let mut variants = vec![*axes];
    for i in 0..AXES {
        let turned = |axes: &[f64; AXES]| {
            let (angle, limits_deg) = (axes[i], robot.limits_at_deg(&axes.map(f64::to_degrees)));
            let [low, high] = limits_deg[i].map(f64::to_radians);
            let first = ((low - ZERO_RAD - angle) / TAU).ceil();
            // Limits are a few turns at most: more would be a mistake in the file, not a robot.
            (0..8)
                .map(move |more| angle + TAU * (first + f64::from(more)))
                .filter(move |a| *a <= high + ZERO_RAD)
        };
        variants = variants
            .iter()
            .flat_map(|axes| {
                turned(axes).map(move |angle| {
                    let mut variant = *axes;
                    variant[i] = angle;
                    variant
                })
            })
            .collect();
    }
    variants
}

/// The axis angles (rad) that a controller takes for a pose with status and turn (S and T of an E6POS;
/// bits of S above 2 say nothing about the branch).
///
/// # Errors
/// Out of reach, or no axis angles within the limits have them.
pub fn from_status_turn(
    robot: &Robot,
    ball: &Pose,
    wanted_status: u8,
    wanted_turn: u8,
) -> Result<[f64; AXES], Unsolved> {
    let wanted_status = wanted_status & 7;
    branches(&robot.geometry, ball)?
        .iter()
        .filter(|axes| status(&robot.geometry, axes) == wanted_status)
        .flat_map(|axes| turns_within(axes, robot))
        .find(|axes| turn(axes) == wanted_turn)
        .ok_or(Unsolved::NoSuchConfiguration { status: wanted_status, turn: wanted_turn })
}

/// ABB's `cf1`, `cf4`, `cf6` and `cfx` of an arm with a spherical wrist at axis angles in rad: the quadrants of axes 1, 4
/// and 6 (0 from 0 to 90 degrees, -1 from -90 to 0), and 4 for a wrist centre behind axis 1, 2 for one behind the lower
/// arm, 1 for a negative axis 5 (RAPID reference, `confdata`).
pub fn quadrants(geometry: &Geometry, axes: &[f64; AXES]) -> [i32; 4] {
    let quadrant = |axis: usize| ((axes[axis] + ZERO_RAD) / std::f64::consts::FRAC_PI_2).floor() as i32;
    let bits = status(geometry, axes);
    let [behind, in_front, negative] = [bits & 1, bits >> 1 & 1, bits >> 2 & 1];
    let cfx = 4 * behind + 2 * (1 - in_front) + negative;
    [quadrant(0), quadrant(3), quadrant(5), i32::from(cfx)]
}

/// The axis angles (rad) that a controller takes for a pose with ABB's configuration. An axis on the border
/// of two quadrants has both.
///
/// # Errors
/// Out of reach, or no axis angles within the limits have it.
pub fn from_quadrants(robot: &Robot, ball: &Pose, wanted: [i32; 4]) -> Result<[f64; AXES], Unsolved> {
    let near = |axes: &[f64; AXES], sign: f64| {
        let mut moved = *axes;
        [0, 3, 5].into_iter().for_each(|axis| moved[axis] += sign * BORDER_RAD);
        quadrants(&robot.geometry, &moved)
    };
    branches(&robot.geometry, ball)?
        .iter()
        .flat_map(|axes| turns_within(axes, robot))
        .find(|axes| {
            let (low, high) = (near(axes, -1.0), near(axes, 1.0));
            (0..4).all(|part| wanted[part] == low[part] || wanted[part] == high[part])
        })
        .ok_or_else(|| Unsolved::NoSuchQuadrants { wanted: format!("{wanted:?}") })
}

/// FANUC's CONFIG, as `N U T, 0, 0, 0`: the branch of an arm with a spherical wrist, and its turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FanucConfiguration {
    /// F: axis 5 is above zero; else N.
    flip: bool,
    /// D: the wrist centre is past the line through shoulder and elbow; else U.
    down: bool,
    /// B: the wrist centre is behind axis 1; else T.
    back: bool,
    /// Turns of axes 1, 4 and 6: 0 within half a turn of zero, 1 from 180 to 539 degrees, -1 from -539 to -180.
    turns: [i32; 3],
}

/// The axes whose turns CONFIG counts, from 0.
const COUNTED: [usize; 3] = [0, 3, 5];

impl FanucConfiguration {
    /// The configuration at axis angles in rad; `None` where the rule is not known: for an arm without a spherical
    /// wrist.
    pub fn at(geometry: &Geometry, axes: &[f64; AXES]) -> Option<Self> {
        let arm = closed::ClosedFormArm::near(geometry).filter(closed::ClosedFormArm::has_wrist)?;
        let turns = COUNTED.map(|axis| (axes[axis] / TAU).round() as i32);
        let (flip, down) = (arm.wrist(axes) > ZERO_RAD, arm.elbow(axes) > ZERO_RAD);
        Some(Self { flip, down, back: forward(geometry, axes) < 0.0, turns })
    }

    /// As [`Self::at`]; `None` also where the digits of a pose leave the configuration open.
    pub fn certain(geometry: &Geometry, axes: &[f64; AXES]) -> Option<Self> {
        let [low, high] = [-BORDER_RAD, BORDER_RAD].map(|by| Self::at(geometry, &axes.map(|axis| axis + by)));
        low.filter(|low| high == Some(*low))
    }

    /// Whether two name the same branch, whatever their turns.
    pub fn is_branch_of(&self, other: &Self) -> bool {
        *self == Self { turns: self.turns, ..*other }
    }
}

impl fmt::Display for FanucConfiguration {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let letter = |is_set: bool, [set, not]: [char; 2]| if is_set { set } else { not };
        let [flip, down, back] = [(self.flip, ['F', 'N']), (self.down, ['D', 'U']), (self.back, ['B', 'T'])]
            .map(|(is, of)| letter(is, of));
        let [first, fourth, sixth] = self.turns;
        write!(out, "{flip} {down} {back}, {first}, {fourth}, {sixth}")
    }
}

impl FromStr for FanucConfiguration {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let (letters, turns) = text.split_once(',').ok_or(())?;
        let letter = |at: usize, [set, not]: [&str; 2]| match letters.split_whitespace().nth(at) {
            Some(letter) if letter == set => Ok(true),
            Some(letter) if letter == not => Ok(false),
            Some(_) | None => Err(()),
        };
        let turns: Result<Vec<i32>, _> = turns.split(',').map(|turn| turn.trim().parse()).collect();
        let is_whole = letters.split_whitespace().count() == COUNTED.len();
        Ok(Self {
            flip: letter(0, ["F", "N"])?,
            down: letter(1, ["D", "U"])?,
            back: letter(2, ["B", "T"])?,
            turns: turns.ok().and_then(|turns| turns.try_into().ok()).filter(|_| is_whole).ok_or(())?,
        })
    }
}

/// The axis angles (rad) that a controller takes for a pose with FANUC's CONFIG: with the turns that it names, or on a line
/// (`near`, the axis angles before) with those that are nearest.
///
/// # Errors
/// Out of reach, or no axis angles within the limits have it.
pub fn from_fanuc(
    robot: &Robot,
    ball: &Pose,
    wanted: FanucConfiguration,
    near: Option<&[f64; AXES]>,
) -> Result<[f64; AXES], Unsolved> {
    let geometry = &robot.geometry;
    // An axis on a border has both configurations.
    let about = |axes: &[f64; AXES]| {
        [-BORDER_RAD, BORDER_RAD].map(|by| FanucConfiguration::at(geometry, &axes.map(|axis| axis + by)))
    };
    let none = || Unsolved::NoSuchQuadrants { wanted: wanted.to_string() };
    let found = branches(geometry, ball)?;
    let mut turned = found.iter().flat_map(|axes| turns_within(axes, robot));
    match near {
        None => turned.find(|axes| about(axes).contains(&Some(wanted))).ok_or_else(none),
        Some(near) => {
            let of_branch =
                turned.filter(|axes| about(axes).iter().flatten().any(|is| is.is_branch_of(&wanted)));
            let distance = |axes: &[f64; AXES]| max_axis_difference(axes, near);
            of_branch.min_by(|a, b| distance(a).total_cmp(&distance(b))).ok_or_else(none)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot(name: &str) -> Robot {
        Robot::by_name(name).unwrap().unwrap()
    }

    const fn deg(degrees: f64) -> f64 {
        degrees * std::f64::consts::PI / 180.0
    }

    /// KUKA's turn: one bit for each negative axis.
    #[test]
    fn turn_has_a_bit_for_each_negative_axis() {
        assert_eq!(turn(&[0.0, -0.1, 0.1, -7.0, -1e-9, 3.0]), 0b00_1010);
        assert_eq!(turn(&[-0.1, 0.1, 0.1, 0.1, 0.1, -2e-8]), 0b10_0001);
    }

    /// The KR 60 HA is stretched where the forearm goes on from the upper arm: A3 = atan(145 / 820) = 10.03 degrees.
    #[test]
    fn status_has_the_bits_of_wrist_centre_elbow_and_flip() {
        let geometry = robot("kr60ha").geometry;
        let base = [0.0, -90.0, 90.0, 0.0, 45.0, 0.0];
        for (change, bits) in [
            (&[][..], 0b010),
            (&[(4, -45.0)], 0b110),
            (&[(4, 0.0)], 0b010),
            // Leaning back by far brings the wrist centre behind axis 1.
            (&[(1, -130.0), (2, 20.0)], 0b011),
            (&[(1, -130.0), (2, 0.0)], 0b001),
            (&[(2, 10.2)], 0b010),
            (&[(2, 9.9)], 0b000),
        ] {
            let mut axes = base;
            change.iter().for_each(|(axis, value)| axes[*axis] = *value);
            assert_eq!(status(&geometry, &axes.map(deg)), bits, "{axes:?}");
        }
    }

    #[test]
    fn clearance_is_the_angle_from_straight_and_the_distance_from_axis_1() {
        let geometry = robot("kr60ha").geometry;
        let stretched = 145f64.atan2(820.0);
        let axes = [0.4, deg(-90.0), stretched + 0.3, 1.0, -0.2, 0.7];
        let found = clearance(&geometry, &axes).unwrap();
        assert!((found.wrist - 0.2).abs() < 1e-12 && (found.elbow - 0.3).abs() < 1e-12, "{found:?}");
        // The arm is upright: the wrist is 350 + hypot(145, 820) sin(0.3) in front of axis 1.
        let overhead = 350.0 + 145f64.hypot(820.0) * 0.3f64.sin();
        assert!((found.overhead - overhead).abs() < 1e-9, "{found:?} {overhead}");
        assert!(clearance(&robot("crx10ia").geometry, &axes).is_none());
    }

    #[test]
    fn turns_are_all_those_within_the_limits() {
        let robot = robot("kr60ha");
        // Axes 4 and 6 go from -350 to 350 degrees, the others less than a turn.
        let axes = [10.0, -60.0, 80.0, 100.0, 30.0, -20.0].map(deg);
        let found = turns_within(&axes, &robot);
        assert_eq!(found.len(), 4);
        let of = |axis: usize| found.iter().map(move |axes| axes[axis].to_degrees().round() as i32);
        let (mut fourth, mut sixth): (Vec<i32>, Vec<i32>) = (of(3).collect(), of(5).collect());
        fourth.sort_unstable();
        sixth.sort_unstable();
        assert_eq!((fourth, sixth), (vec![-260, -260, 100, 100], vec![-20, -20, 340, 340]));
        assert!(turns_within(&[0.0, deg(60.0), 0.0, 0.0, 0.0, 0.0], &robot).is_empty());
        assert_eq!(
            turns_within(&[0.0, deg(35.0), 0.0, deg(5.0), 0.0, 0.0], &robot).len(),
            1,
            "a limit is within"
        );
    }

    #[test]
    fn status_and_turn_choose_the_axes_of_a_pose() {
        let robot = robot("kr60ha");
        for axes_deg in [
            [10.0, -60.0, 80.0, 100.0, 30.0, -20.0],
            [10.0, -60.0, 80.0, -260.0, 30.0, 340.0],
            [-100.0, -100.0, 60.0, 20.0, -50.0, 200.0],
        ] {
            let axes = axes_deg.map(deg);
            let ball = robot.geometry.ball(&axes);
            let found = from_status_turn(&robot, &ball, status(&robot.geometry, &axes), turn(&axes)).unwrap();
            assert!(crate::robot::max_axis_difference(&found, &axes) < 1e-9, "{axes_deg:?}");
            // Bits of S above 2 do not matter.
            assert!(from_status_turn(&robot, &ball, status(&robot.geometry, &axes) | 8, turn(&axes)).is_ok());
        }
        let ball = robot.geometry.ball(&[10.0, -60.0, 80.0, 100.0, 30.0, -20.0].map(deg));
        let wrong = from_status_turn(&robot, &ball, 2, 0b01_0010);
        assert!(
            matches!(wrong, Err(Unsolved::NoSuchConfiguration { status: 2, turn: 0b01_0010 })),
            "{wrong:?}"
        );
    }

    /// RAPID reference, confdata: quadrant 0 is 0 to 90 degrees, -1 is -90 to 0.
    #[test]
    fn quadrants_are_abbs_configuration() {
        let robot = robot("irb120");
        let axes = [-10.0, 20.0, 10.0, 100.0, 40.0, -100.0].map(deg);
        assert_eq!(quadrants(&robot.geometry, &axes), [-1, 1, -2, 0]);
        let mut flipped = axes;
        flipped[4] = deg(-40.0);
        assert_eq!(quadrants(&robot.geometry, &flipped), [-1, 1, -2, 1]);
        let ball = robot.geometry.ball(&axes);
        let found = from_quadrants(&robot, &ball, [-1, 1, -2, 0]).unwrap();
        assert!(crate::robot::max_axis_difference(&found, &axes) < 1e-9);
        assert!(matches!(
            from_quadrants(&robot, &ball, [3, 1, -2, 0]),
            Err(Unsolved::NoSuchQuadrants { .. })
        ));
        // An axis on a border has both quadrants.
        let border = [0.0, 20.0, 10.0, 90.0, 40.0, -90.0].map(deg);
        let ball = robot.geometry.ball(&border);
        for wanted in [[0, 1, -1, 0], [-1, 0, -2, 0]] {
            assert!(from_quadrants(&robot, &ball, wanted).is_ok(), "{wanted:?}");
        }
    }

    /// J1 to J6 and CONFIG of an M-20iD/25 from the virtual controller of the maker (ROBOGUIDE), published by the project robconv
    /// (tests/fixtures/probes/results/CFGPROBE_roboguide.LS).
    const ROBOGUIDE: [([f64; 6], &str); 16] = [
        ([0.0, 0.0, 0.0, 0.0, -90.0, 0.0], "N U T, 0, 0, 0"),
        ([0.0, 0.0, 0.0, 0.0, 90.0, 0.0], "F U T, 0, 0, 0"),
        ([0.0, 0.0, 0.0, 0.0, -30.0, 0.0], "N U T, 0, 0, 0"),
        ([0.0, 0.0, 0.0, 0.0, 30.0, 0.0], "F U T, 0, 0, 0"),
        ([0.0, 0.0, 0.0, 185.0, -90.0, 0.0], "N U T, 0, 1, 0"),
        ([0.0, 0.0, 0.0, -185.0, -90.0, 0.0], "N U T, 0, -1, 0"),
        ([0.0, 0.0, 0.0, 0.0, -90.0, 190.0], "N U T, 0, 0, 1"),
        ([0.0, 0.0, 0.0, 0.0, -90.0, -190.0], "N U T, 0, 0, -1"),
        ([0.0, 0.0, 0.0, 0.0, -90.0, 350.0], "N U T, 0, 0, 1"),
        ([0.0, 40.0, 60.0, 0.0, -90.0, 0.0], "N D T, 0, 0, 0"),
        ([0.0, 40.0, -60.0, 0.0, -90.0, 0.0], "N U T, 0, 0, 0"),
        ([0.0, -60.0, -80.0, 0.0, -90.0, 0.0], "N D B, 0, 0, 0"),
        ([0.0, -60.0, 80.0, 0.0, -90.0, 0.0], "N U B, 0, 0, 0"),
        ([0.0, 60.0, 80.0, 0.0, -90.0, 0.0], "N D T, 0, 0, 0"),
        ([90.0, 0.0, 0.0, 0.0, -90.0, 0.0], "N U T, 0, 0, 0"),
        ([-150.0, 0.0, 0.0, 0.0, -90.0, 0.0], "N U T, 0, 0, 0"),
    ];

    #[test]
    fn fanuc_configurations_are_those_of_the_virtual_controller() {
        // Joint 3 of one pose is beyond the limit of the sum.
        let robot = Robot { coupled_limits_deg: [None; AXES], ..robot("m20id25") };
        for (axes_deg, config) in ROBOGUIDE {
            let axes = axes_deg.map(deg);
            let found = FanucConfiguration::certain(&robot.geometry, &axes).unwrap();
            assert_eq!(found.to_string(), config, "{axes_deg:?}");
            assert_eq!(config.parse(), Ok(found));
            let ball = robot.geometry.ball(&axes);
            let back = from_fanuc(&robot, &ball, found, None).unwrap();
            assert!(max_axis_difference(&back, &axes) < 1e-6, "{axes_deg:?}");
            // On a line the turns are those of the axes before.
            let plain = FanucConfiguration { turns: [0; 3], ..found };
            let on_line = from_fanuc(&robot, &ball, plain, Some(&axes.map(|axis| axis + 0.02))).unwrap();
            assert!(max_axis_difference(&on_line, &axes) < 1e-6, "{axes_deg:?}");
        }
        // Axis 1 makes no full turn.
        let other = "N U T, 1, 0, 0".parse().unwrap();
        let ball = robot.geometry.ball(&[0.0, 0.0, 0.0, 0.0, -90.0, 0.0].map(deg));
        assert!(matches!(from_fanuc(&robot, &ball, other, None), Err(Unsolved::NoSuchQuadrants { .. })));
    }

    #[test]
    fn fanuc_configuration_is_open_on_a_border_and_for_other_wrists() {
        let at =
            |name: &str, axes: [f64; 6]| FanucConfiguration::certain(&robot(name).geometry, &axes.map(deg));
        assert!(at("m20id25", [0.0, 0.0, 0.0, 0.0, 0.004, 0.0]).is_none());
        assert!(at("m20id25", [0.0, 0.0, 0.0, 0.0, 0.006, 0.0]).is_some());
        assert!(at("m20id25", [0.0, 0.0, 0.0, 179.996, -50.0, 0.0]).is_none());
        for (name, axes) in [
            ("crx10ia", [0.0, 20.0, 10.0, 10.0, -50.0, 0.0]),
            ("ur10e", [10.0, -80.0, 90.0, 10.0, 60.0, 0.0]),
        ] {
            assert!(at(name, axes).is_none(), "{name}");
        }
        for wrong in [
            "",
            "N U T",
            "N U T, 0, 0",
            "N U X, 0, 0, 0",
            "N U T L, 0, 0, 0",
            "N U T, 0, 0, 0, x",
            "N U T, a, 0, 0",
        ] {
            assert!(wrong.parse::<FanucConfiguration>().is_err(), "{wrong}");
        }
    }
}
