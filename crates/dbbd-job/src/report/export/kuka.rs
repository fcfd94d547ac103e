//! Values for the machine data of a KUKA controller that bring its model nearest to an identified arm, where its zeros are mastered.
//!
//! The controller's inverse kinematics need axis 2 normal to axis 1 and axis 3 parallel to axis 2, so that twists there
//! cannot be entered. The other values are fitted to the flange over the workspace.

use std::fmt::Write;

use nalgebra::{DMatrix, DVector, Vector3};

use super::mastering::zeros;
use crate::robot_description::{MachineData, WristLink};
use dbbd_model::estimation::Workspace;
use dbbd_model::robot::{AXES, DhRow, Geometry, Pose, Robot};

/// Poses over which the values are fitted, and their seed.
const POSES: usize = 200;
const SEED: u64 = 2;
/// Points of the flange whose places are fitted, mm: they show its orientation as well.
const ON_FLANGE_MM: [[f64; 3]; 3] = [[0.0; 3], [300.0, 0.0, 0.0], [0.0, 300.0, 0.0]];
/// Unknowns of the fit that are not identified: the place of the arm in the room, with six of them.
const RIGID: usize = 6;
/// A degree at a metre, mm: the unit of angles in the fit.
const MM_PER_DEG: f64 = 17.45;
/// Weight of the nominal value beside the data: a value on which the flange does not depend stays nominal.
const DAMPING: f64 = 1e-9;
/// Number of steps. The errors of an arm are small: every step gains at least three digits.
const STEPS: usize = 6;
/// Step of the differences, mm.
const STEP_MM: f64 = 1e-3;

/// A value that may be entered: the access to it, and its unit in mm.
struct MachineValue {
    of: fn(&mut MachineData) -> &mut f64,
    mm: f64,
}

/// The values of the fit. At B = 90 degrees C turns as A does, and the turn about axis 4 is its zero.
const VALUES: [MachineValue; 13] = [
    MachineValue { of: |data| &mut data.length_a, mm: 1.0 },
    MachineValue { of: |data| &mut data.length_b, mm: 1.0 },
    MachineValue { of: |data| &mut data.tx3p3[0], mm: 1.0 },
    MachineValue { of: |data| &mut data.tx3p3[1], mm: 1.0 },
    MachineValue { of: |data| &mut data.tx3p3[2], mm: 1.0 },
    MachineValue { of: |data| &mut data.tx3p3[3], mm: MM_PER_DEG },
    MachineValue { of: |data| &mut data.tx3p3[4], mm: MM_PER_DEG },
    MachineValue { of: |data| &mut data.dh_4.a, mm: 1.0 },
    MachineValue { of: |data| &mut data.dh_4.alpha_deg, mm: MM_PER_DEG },
    MachineValue { of: |data| &mut data.dh_5.a, mm: 1.0 },
    MachineValue { of: |data| &mut data.dh_5.d, mm: 1.0 },
    MachineValue { of: |data| &mut data.dh_5.alpha_deg, mm: MM_PER_DEG },
    MachineValue { of: |data| &mut data.tflwp[2], mm: 1.0 },
];

/// The nominal values and the proposed values.
pub(super) struct MachineDataProposal {
    nominal: MachineData,
    proposed: MachineData,
}

impl MachineDataProposal {
    /// The proposal for a robot; `None` if the nominal robot is not a KUKA with a central wrist.
    pub(super) fn of(robot: &Robot) -> Option<Self> {
        let nominal = MachineData::of(&robot.controller().geometry)?;
        let mut fit = MachineDataFit::new(robot);
        let mut proposed = nominal.clone();
        for _ in 0..STEPS {
            fit.step(&nominal, &mut proposed)?;
        }
        Some(Self { nominal, proposed })
    }

    /// The arm with which the controller computes once values and zeros are entered, with the tool ball of `robot`.
    pub(super) fn geometry(&self, robot: &Robot) -> Geometry {
        let zeros = zeros(robot);
        let table = self.proposed.table();
        let rows = std::array::from_fn(|at| {
            let row = table.rows[at];
            DhRow { theta: row.theta + row.sign * zeros[at], ..row }
        });
        let tool = table.flange.position + table.flange.rotation * robot.geometry.tool;
        Geometry { rows, tool, ..robot.geometry.rigid() }
    }

    /// `machine-data.txt`: the values as KRL declares them, with the nominal values as comments.
    pub(super) fn text(&self, robot: &str) -> String {
        let mut text = format!(
            "; Proposal for the machine data of {robot}: mm and degrees, with the zeros of mastering.csv.\n\
             ; This is no file to copy. Compare the nominal values with $machine.dat of your controller first: where one differs, the file has\n\
             ; another form, and nothing of this may be entered. Keep a backup. KUKA supports no change of machine data.\n"
        );
        let frame = |[x, y, z, a, b, c]: [f64; 6]| {
            let [x, y, z, a, b, c] = [x, y, z, a, b, c].map(number);
            format!("{{X {x},Y {y},Z {z},A {a},B {b},C {c}}}")
        };
        let link = |link: WristLink| {
            let [a, d, alpha] = [link.a, link.d, link.alpha_deg].map(number);
            format!("{{DHART_A {a},DHART_D {d},DHART_ALPHA {alpha}}}")
        };
        let [nominal, proposed] = [&self.nominal, &self.proposed].map(|data| {
            [
                ("REAL $LENGTH_A", number(data.length_a)),
                ("REAL $LENGTH_B", number(data.length_b)),
                ("FRAME $TX3P3", frame(data.tx3p3)),
                ("DECL DHART $DH_4", link(data.dh_4)),
                ("DECL DHART $DH_5", link(data.dh_5)),
                ("FRAME $TFLWP", frame(data.tflwp)),
            ]
        });
        for ((name, nominal), (_, proposed)) in nominal.into_iter().zip(proposed) {
            let _ = writeln!(text, "{name}={proposed} ; nominal {nominal}");
        }
        text
    }
}

/// Five decimals: a controller has about seven digits.
fn number(value: f64) -> String {
    let text = format!("{value:.5}");
    if text == "-0.00000" { "0.00000".into() } else { text }
}

/// The places of the points of the identified flange, and the axis angles that the mastered controller shows there.
struct MachineDataFit {
    shown: Vec<[f64; AXES]>,
    places: Vec<Vector3<f64>>,
    /// Base of the controller's model in the robot's base: shifts (mm), then turns (rad).
    base: [f64; RIGID],
}

impl MachineDataFit {
    fn new(robot: &Robot) -> Self {
        let (zeros, rigid) = (zeros(robot), robot.geometry.rigid());
        let poses = Workspace::uniform(robot.controller(), POSES, SEED);
        Self {
            shown: poses.iter().map(|axes| std::array::from_fn(|at| axes[at] + zeros[at])).collect(),
            places: poses.iter().flat_map(|axes| points(&rigid.flange(axes))).collect(),
            base: [0.0; RIGID],
        }
    }

    /// The points by the machine data, in the base of the robot.
    fn model(&self, data: &MachineData, base: &[f64; RIGID]) -> DVector<f64> {
        let [x, y, z, turns @ ..] = *base;
        let base = Pose::from_rotation_vector([x, y, z], turns);
        let points = self.shown.iter().flat_map(|axes| points(&base.then(&data.flange(axes))));
        DVector::from_iterator(3 * self.places.len(), points.flat_map(<[f64; 3]>::from))
    }

    /// A damped Gauss-Newton step of the values and of the base; `None` if the system is singular.
    fn step(&mut self, nominal: &MachineData, data: &mut MachineData) -> Option<()> {
        let (unknowns, mm_per_rad) = (VALUES.len() + RIGID, MM_PER_DEG.to_degrees());
        let here = self.model(data, &self.base);
        let places = self.places.iter().flat_map(|place| <[f64; 3]>::from(*place));
        let residual = DVector::from_iterator(here.len(), places) - &here;
        let mut jacobian = DMatrix::zeros(here.len(), unknowns);
        for (column, value) in VALUES.iter().enumerate() {
            let mut moved = data.clone();
            *(value.of)(&mut moved) += STEP_MM / value.mm;
            jacobian.set_column(column, &((self.model(&moved, &self.base) - &here) / STEP_MM));
        }
        for at in 0..RIGID {
            let mut base = self.base;
            base[at] += if at < 3 { STEP_MM } else { STEP_MM / mm_per_rad };
            jacobian.set_column(VALUES.len() + at, &((self.model(data, &base) - &here) / STEP_MM));
        }
        let mut normal = jacobian.tr_mul(&jacobian);
        let mut rhs = jacobian.tr_mul(&residual);
        let weight = DAMPING * normal.diagonal().max();
        for (at, value) in VALUES.iter().enumerate() {
            normal[(at, at)] += weight;
            let from_nominal = *(value.of)(data) - *(value.of)(&mut nominal.clone());
            rhs[at] -= weight * value.mm * from_nominal;
        }
        let step = normal.cholesky()?.solve(&rhs);
        for (value, step) in VALUES.iter().zip(step.iter()) {
            *(value.of)(data) += step / value.mm;
        }
        for (at, base) in self.base.iter_mut().enumerate() {
            *base += step[VALUES.len() + at] / if at < 3 { 1.0 } else { mm_per_rad };
        }
        Some(())
    }
}

fn points(flange: &Pose) -> [Vector3<f64>; ON_FLANGE_MM.len()] {
    ON_FLANGE_MM.map(|point| flange.position + flange.rotation * Vector3::from(point))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbbd_model::estimation::SimplifiedModelError;
    use dbbd_model::robot::ParamId;

    fn with_errors(errors: &[(&str, f64)]) -> Robot {
        let nominal = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let mut robot = Robot { nominal: Some(Box::new(nominal.clone())), ..nominal };
        for (name, error) in errors {
            let id: ParamId = name.parse().unwrap();
            *robot.geometry.value_mut(id).unwrap() += error;
        }
        robot
    }

    fn remains(robot: &Robot) -> SimplifiedModelError {
        let proposal = MachineDataProposal::of(robot).unwrap();
        SimplifiedModelError::by(robot, &proposal.geometry(robot))
    }

    /// Errors for which the machine data have a value are entered completely; the zeros are mastered. A fit of the same
    /// values in numpy leaves 2e-8 mm.
    #[test]
    fn what_machine_data_hold_is_entered_wholly() {
        let robot = with_errors(&[
            ("a1", 0.4),
            ("a2", -0.7),
            ("a3", 0.5),
            ("d4", 0.6),
            ("d2", 0.3),
            ("d5", -0.1),
            ("alpha3", 5e-4),
            ("alpha4", -4e-4),
            ("alpha5", 3e-4),
            ("a4", 0.05),
            ("a5", -0.08),
            ("d6", 0.3),
            ("theta2", 6e-4),
            ("theta3", -5e-4),
            ("theta4", 4e-4),
            ("theta5", 8e-4),
        ]);
        let (before, after) =
            (SimplifiedModelError::by(&robot, &robot.controller().geometry), remains(&robot));
        assert!(before.mean_mm > 0.5 && after.max_mm < 1e-6, "{before:?} {after:?}");
        let proposal = MachineDataProposal::of(&robot).unwrap();
        assert!((proposal.proposed.length_a - 350.4).abs() < 1e-6, "{:?}", proposal.proposed);
        assert!((proposal.proposed.length_b - 849.3).abs() < 1e-6);
        assert!((proposal.proposed.tflwp[2] - 170.3).abs() < 1e-6);
        // Values that no data identify stay nominal.
        assert_eq!(proposal.proposed.tiroro, proposal.nominal.tiroro);
        let text = proposal.text("KUKA KR 60 HA");
        assert!(
            (proposal.proposed.tx3p3[1] - 0.71).abs() < 1e-3,
            "d2 and the twist alpha3 of an arm of 820 mm"
        );
        assert!(
            text.contains("REAL $LENGTH_A=350.40000 ; nominal 350.00000\n")
                && text.contains("; nominal 350.00000\n"),
            "{text}"
        );
    }

    /// A twist between axes 1 and 2 and one between 2 and 3 are no machine data: their errors remain, and the fit does not add to them.
    /// numpy's fit leaves 0.340, 0.300 and 0.236 mm at other poses.
    #[test]
    fn twists_of_the_main_axes_remain() {
        for (name, expected_mm) in [("alpha1", 0.340), ("alpha2", 0.300), ("beta2", 0.236)] {
            let robot = with_errors(&[(name, 5e-4)]);
            let (before, after) =
                (SimplifiedModelError::by(&robot, &robot.controller().geometry), remains(&robot));
            assert!(
                (after.mean_mm / expected_mm - 1.0).abs() < 0.1 && after.mean_mm < before.mean_mm,
                "{name}: {before:?} {after:?}"
            );
        }
    }
}
