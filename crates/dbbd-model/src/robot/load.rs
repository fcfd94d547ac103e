//! The load of the joints: the masses of the links and the payload on the flange, under gravity.

use nalgebra::Vector3;

use super::dh_row::DhRow;
use super::{AXES, Joint, RobotFinding};
use crate::diagnostic::Diagnostic;
use crate::plausibility::Quantity;

/// Standard gravity, m/s^2.
const GRAVITY: f64 = 9.806_65;

/// A mass that loads the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mass {
    /// The joint whose frame it moves with.
    pub joint: Joint,
    pub kg: f64,
    /// Centre of mass in that joint's frame, mm.
    pub centre: Vector3<f64>,
}

impl Mass {
    /// The mass, kg, and its first moment about the origin of the frame, kg mm.
    pub(super) fn moments(&self) -> (f64, Vector3<f64>) {
        (self.kg, self.centre * self.kg)
    }
}

/// A payload on the flange.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Payload {
    /// The name by which rows of measurements and commands refer to the payload; may be empty.
    pub name: String,
    pub kg: f64,
    /// Centre of mass in the flange frame, mm.
    pub centre: Vector3<f64>,
    /// Standard uncertainties of the mass (kg) and of each coordinate of its centre (mm).
    pub u_kg: f64,
    pub u_mm: f64,
    /// Whether the robot carried this payload when it was identified.
    pub is_measured: bool,
}

/// The mass of a holder and its ball, which are not stated, kg.
const HOLDER_KG: f64 = 3.0;

impl Payload {
    /// Checks that the numbers are possible. An empty flange is a payload too.
    pub(super) fn check(&self) -> Result<(), Diagnostic> {
        let Self { kg, u_kg, u_mm, .. } = *self;
        let masses = [("kg", kg), ("u_kg", u_kg)];
        masses
            .into_iter()
            .filter(|(_, kg)| *kg != 0.0)
            .try_for_each(|(key, kg)| Quantity::Mass.check(key, kg))?;
        if u_kg > kg.max(HOLDER_KG) {
            return Err(RobotFinding::PayloadUncertainty { kg, u_kg }.into());
        }
        Quantity::ArmLength.check("u_mm", u_mm)?;
        let distance_mm = self.centre.norm();
        if distance_mm != 0.0 {
            Quantity::PayloadDistance.check("centre_mm", distance_mm)?;
        }
        Ok(())
    }

    /// The payload as a mass of the last frame.
    pub fn mass(&self) -> Mass {
        Mass { joint: Joint::J6, kg: self.kg, centre: self.centre }
    }
}

/// Gravity torque about each joint, N m.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct GravityTorques {
    /// Torque of links and payload together.
    pub(crate) all: [f64; AXES],
    /// Torque of the payload alone.
    pub(crate) payload: [f64; AXES],
}

/// The masses of an arm with its payload.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmLoad {
    /// Masses of the links.
    pub masses: Vec<Mass>,
    /// Whether the masses follow from the size of the arm, because its file states none.
    pub is_assumed: bool,
    /// The possible payloads, by [`super::PayloadId::index`]; the first one is the default.
    pub payloads: Vec<Payload>,
    /// Unit vector of gravity in the robot base.
    pub gravity: Vector3<f64>,
}

impl ArmLoad {
    /// Gravity for an arm on the floor.
    pub const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);

    /// A load with known masses.
    pub fn known(masses: Vec<Mass>) -> Self {
        Self { masses, is_assumed: false, payloads: Vec::new(), gravity: Self::DOWN }
    }

    /// The masses of a usual arm of this size: each link in the middle between its joints. For an arm of the KUKA KR 60's size the
    /// sum is 320 kg.
    pub fn usual(rows: &[DhRow; AXES]) -> Self {
        /// Mass beyond the second joint over the cube of the length beyond it, kg/m^3.
        const KG_PER_M3: f64 = 50.0;
        /// Distribution of that mass over the links that joints 2 to 6 move.
        const SHARES: [f64; AXES] = [0.0, 0.45, 0.35, 0.1, 0.05, 0.05];
        let kg = KG_PER_M3 * (1e-3 * rows[2..].iter().map(DhRow::length).sum::<f64>()).powi(3);
        let to_next = |link: usize| rows.get(link + 1).map_or_else(Vector3::zeros, DhRow::origin);
        let mass = |joint: Joint| {
            let at = joint.index();
            Mass { joint, kg: SHARES[at] * kg, centre: 0.5 * to_next(at) }
        };
        let masses = Joint::ALL.into_iter().map(mass).filter(|mass| mass.kg > 0.0).collect();
        Self { is_assumed: true, ..Self::known(masses) }
    }

    /// The default payload.
    pub fn carried(&self) -> Option<&Payload> {
        self.payloads.first()
    }

    /// Puts a payload in front: one of the list by its name, or `KG,X,Y,Z` with its centre in the flange frame, mm.
    ///
    /// # Errors
    /// `asked` is neither, or the numbers are not plausible.
    pub fn carry(&mut self, asked: &str) -> Result<(), Diagnostic> {
        let payload = match self.payloads.iter().position(|payload| payload.name == asked) {
            Some(at) => self.payloads.remove(at),
            None => self.by_numbers(asked)?,
        };
        self.payloads.insert(0, payload);
        Ok(())
    }

    /// The names of the payloads.
    pub(crate) fn named(&self) -> String {
        let names: Vec<&str> = self.payloads.iter().map(|payload| payload.name.as_str()).collect();
        if names.is_empty() { "it has none".into() } else { names.join(", ") }
    }

    /// The payload `KG,X,Y,Z`.
    fn by_numbers(&self, asked: &str) -> Result<Payload, Diagnostic> {
        let numbers: Option<Vec<f64>> = asked.split(',').map(|part| part.trim().parse().ok()).collect();
        let Some(Ok([kg, x, y, z])) = numbers.map(<[f64; 4]>::try_from) else {
            return Err(RobotFinding::NoSuchPayload { asked: asked.into(), known: self.named() }.into());
        };
        let payload = Payload { name: asked.into(), kg, centre: Vector3::new(x, y, z), ..Payload::default() };
        payload.check()?;
        Ok(payload)
    }

    /// The mass of the payload carried, and of the heaviest that was measured, if that is much lighter, kg.
    pub fn beyond_measured(&self) -> Option<[f64; 2]> {
        let measured = self.payloads.iter().filter(|payload| payload.is_measured);
        let heaviest_kg = measured.map(|payload| payload.kg).fold(0.0, f64::max);
        let carried_kg = self.carried()?.kg;
        (carried_kg > heaviest_kg + HOLDER_KG).then_some([carried_kg, heaviest_kg])
    }

    /// The mass that moves with each row of the table, kg, and its first moment about the origin of the row's frame, kg mm.
    pub(super) fn of_rows(&self) -> [(f64, Vector3<f64>); AXES] {
        let mut of_rows = [(0.0, Vector3::zeros()); AXES];
        for mass in &self.masses {
            let (kg, moment) = &mut of_rows[mass.joint.index()];
            let (of_mass, at_mass) = mass.moments();
            (*kg, *moment) = (*kg + of_mass, *moment + at_mass);
        }
        of_rows
    }

    /// Gravity in the robot base, N m per kg mm.
    pub(super) fn gravity_by_mm(&self) -> Vector3<f64> {
        self.gravity * (1e-3 * GRAVITY)
    }

    /// The approximate payload for which such an arm is made.
    pub(crate) fn rated(&self, rows: &[DhRow; AXES]) -> Payload {
        /// The payload's mass over the masses of the links, and its distance from the flange over the length of the
        /// arm.
        const RATED: f64 = 0.2;
        const LEVER: f64 = 0.1;
        let kg = RATED * self.masses.iter().map(|mass| mass.kg).sum::<f64>();
        let centre = Vector3::z() * (LEVER * rows[2..].iter().map(DhRow::length).sum::<f64>());
        Payload { kg, centre, ..Payload::default() }
    }

    /// An upper bound of the gravity torque about each joint in any pose, N m: every mass at full stretch, with the payload
    /// that such an arm is made for.
    pub(crate) fn greatest_torques(&self, rows: &[DhRow; AXES]) -> [f64; AXES] {
        let rated = self.rated(rows).mass();
        let mut torques = [0.0; AXES];
        for mass in self.masses.iter().copied().chain([rated]) {
            let mut lever_mm = mass.centre.norm();
            for joint in (0..mass.joint.number()).rev() {
                torques[joint] += GRAVITY * mass.kg * lever_mm * 1e-3;
                lever_mm += rows[joint].length();
            }
        }
        torques
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    /// Python from the table of the KR 60 HA: rows 3 to 6 are 850, 832.7, 0 and 170 mm long.
    #[test]
    fn masses_of_a_usual_arm_are_in_the_middle_of_its_links() {
        let geometry = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap().geometry;
        let ArmLoad { masses, is_assumed, payloads, gravity } = geometry.load;
        assert!(is_assumed && payloads.is_empty() && gravity == ArmLoad::DOWN);
        let expected = [
            (Joint::J2, 143.09119194223155, [425.0, 0.0, 0.0]),
            (Joint::J3, 111.2931492884023, [72.5, 410.0, 0.0]),
            (Joint::J4, 31.79804265382923, [0.0; 3]),
            (Joint::J5, 15.899021326914616, [0.0, 85.0, 0.0]),
            (Joint::J6, 15.899021326914616, [0.0; 3]),
        ];
        assert_eq!(masses.len(), expected.len());
        for (mass, (joint, kg, centre)) in masses.iter().zip(expected) {
            assert_eq!(mass.joint, joint);
            assert!((mass.kg - kg).abs() < 1e-9, "{mass:?}");
            assert!((mass.centre - Vector3::from(centre)).norm() < 1e-9, "{mass:?}");
        }
    }

    #[test]
    fn a_payload_is_carried_by_its_name_or_its_numbers() {
        let payload =
            |name: &str, kg| Payload { name: name.into(), kg, is_measured: true, ..Payload::default() };
        let mut load = ArmLoad::known(Vec::new());
        load.payloads = vec![payload("bar", 2.0), payload("gripper", 50.0)];
        assert_eq!((load.carried().unwrap().kg, load.beyond_measured()), (2.0, None));
        load.carry("gripper").unwrap();
        assert_eq!((load.carried().unwrap().kg, load.payloads.len()), (50.0, 2));
        load.carry("53.5,0,0,200").unwrap();
        let carried = load.carried().unwrap();
        assert_eq!((carried.kg, carried.centre), (53.5, Vector3::new(0.0, 0.0, 200.0)));
        assert_eq!(load.beyond_measured(), Some([53.5, 50.0]));
        for wrong in ["grip", "50", "50,0,0", "50,0,0,0,0", "50,0,0,x", ""] {
            assert_eq!(load.carry(wrong).unwrap_err().code().as_str(), "E0582", "{wrong}");
        }
        // Negative, in grams, not a number.
        for wrong in ["-1,0,0,0", "50000,0,0,200", "nan,0,0,0", "50,inf,0,0"] {
            assert_eq!(load.carry(wrong).unwrap_err().code().as_str(), "E0130", "{wrong}");
        }
    }

    #[test]
    fn masses_of_the_file_are_known() {
        let load = Robot::by_name("ur10").unwrap().unwrap().geometry.load;
        assert!(!load.is_assumed);
        let kg: f64 = load.masses.iter().map(|mass| mass.kg).sum();
        assert!((kg - 28.435).abs() < 1e-9, "{kg}");
    }
}
