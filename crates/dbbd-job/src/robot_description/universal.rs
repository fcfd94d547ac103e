//! The factory calibration of a Universal Robots controller: its file `calibration.conf`, the YAML of the ROS driver,
//! or the messages of its primary interface.

use std::io::{self, Read};
use std::net::TcpStream;
use std::time::Duration;

use dbbd_model::robot::pose::{rot_x, rot_y, rot_z};
use dbbd_model::robot::{AXES, ControllerModel, JointAxis, Pose, Robot};
use nalgebra::Vector3;
use saphyr::{LoadableYamlNode, Yaml};

use super::arm_lines::{ArmLines, ImportedRobot};
use super::catalogue::DescriptionFinding;

/// The segments of the YAML, base to flange.
pub(crate) const SEGMENTS: [&str; AXES] =
    ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"];
/// The keys of a segment, m and rad.
pub(crate) const COORDINATES: [&str; 6] = ["x", "y", "z", "roll", "pitch", "yaw"];
/// The port of the primary interface.
const PRIMARY_PORT: u16 = 30001;
/// Longest wait for the kinematics, s: a controller sends them when a client connects.
const WAIT_S: u64 = 5;
/// Most messages in this time: there are at least ten a second.
const MAX_MESSAGES: usize = 500;
/// A message of the primary interface with the state of the robot, and its part with the kinematics.
const ROBOT_STATE: u8 = 16;
const KINEMATICS: u8 = 5;
/// Longest message: longer ones do not come from this interface.
const MAX_MESSAGE: usize = 1 << 16;

/// The table with which a controller computes.
#[derive(Clone, Debug, PartialEq)]
pub enum FactoryTable {
    /// Differences from the nominal table in standard DH, `Rz(theta) Tz(d) Tx(a) Rx(alpha)`, mm and rad.
    Differences(StandardTable),
    /// The whole table in standard DH.
    Whole(StandardTable),
    /// The place of each segment in the segment before it, with its joint at zero.
    Segments(Box<[Pose; AXES]>),
}

/// The columns of a table in standard DH, base to flange; mm and rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StandardTable {
    pub theta: [f64; AXES],
    pub a: [f64; AXES],
    pub d: [f64; AXES],
    pub alpha: [f64; AXES],
}

impl StandardTable {
    /// The standard table of a table in modified DH, whose rows have the a and alpha of the link before; the last link
    /// has none.
    fn of(robot: &Robot) -> Self {
        let rows = &robot.geometry.rows;
        let next = |at: usize| rows.get(at + 1);
        Self {
            theta: rows.map(|row| row.theta),
            a: std::array::from_fn(|at| next(at).map_or(0.0, |row| row.a)),
            d: rows.map(|row| row.d),
            alpha: std::array::from_fn(|at| next(at).map_or(0.0, |row| row.alpha)),
        }
    }

    /// Whether the table is one of Universal Robots: axes that turn by their angles, and the maker's angles between them.
    fn is_of_maker(&self, robot: &Robot) -> bool {
        const ALPHA_DEG: [f64; AXES] = [90.0, 0.0, 0.0, 90.0, -90.0, 0.0];
        /// Angles of arms differ by less from those of their type, degrees.
        const SAME_DEG: f64 = 5.0;
        let is_same = |rad: &[f64; AXES], deg: [f64; AXES]| {
            rad.iter().zip(deg).all(|(rad, deg)| (rad.to_degrees() - deg).abs() < SAME_DEG)
        };
        let is_positive = robot.geometry.rows.iter().all(|row| row.sign > 0.0);
        is_positive && is_same(&self.alpha, ALPHA_DEG) && is_same(&self.theta, [0.0; AXES])
    }

    fn plus(&self, other: &Self) -> Self {
        let sum = |a: &[f64; AXES], b: &[f64; AXES]| std::array::from_fn(|at| a[at] + b[at]);
        Self {
            theta: sum(&self.theta, &other.theta),
            a: sum(&self.a, &other.a),
            d: sum(&self.d, &other.d),
            alpha: sum(&self.alpha, &other.alpha),
        }
    }

    /// The fixed part of each link after its joint.
    fn links(&self) -> [Pose; AXES] {
        std::array::from_fn(|at| {
            let turned = rot_z(self.theta[at]);
            Pose {
                rotation: turned * rot_x(self.alpha[at]),
                position: turned * Vector3::new(self.a[at], 0.0, self.d[at]),
            }
        })
    }
}

impl FactoryTable {
    /// Reads the text of a `calibration.conf`, or of a YAML with `kinematics`.
    pub fn read(text: &str) -> Result<Self, DescriptionFinding> {
        if text.contains("delta_theta") {
            let numbers = |key: &str| six_numbers(text, key);
            let metres = |key: &str| numbers(key).map(|values| values.map(|metres| 1e3 * metres));
            return Ok(Self::Differences(StandardTable {
                theta: numbers("delta_theta")?,
                a: metres("delta_a")?,
                d: metres("delta_d")?,
                alpha: numbers("delta_alpha")?,
            }));
        }
        let documents = Yaml::load_from_str(text).unwrap_or_default();
        let kinematics = documents.first().and_then(|document| document.as_mapping_get("kinematics"));
        let kinematics = kinematics.ok_or(DescriptionFinding::NotKnown)?;
        let mut segments = [Pose::identity(); AXES];
        for (segment, name) in segments.iter_mut().zip(SEGMENTS) {
            let number = |coordinate: &str| {
                let value = kinematics.as_mapping_get(name)?.as_mapping_get(coordinate)?;
                value.as_floating_point().or_else(|| value.as_integer().map(|integer| integer as f64))
            };
            let numbers: Option<Vec<f64>> = COORDINATES.iter().map(|coordinate| number(coordinate)).collect();
            let Some(&[x, y, z, roll, pitch, yaw]) = numbers.as_deref() else {
                return Err(DescriptionFinding::Segment { segment: name.into() });
            };
            *segment = Pose {
                rotation: rot_z(yaw) * rot_y(pitch) * rot_x(roll),
                position: Vector3::new(x, y, z) * 1e3,
            };
        }
        Ok(Self::Segments(Box::new(segments)))
    }

    /// Reads the table that the controller at `host` (with a port, or without) sends.
    pub fn ask(host: &str) -> Result<Self, DescriptionFinding> {
        let address = if host.contains(':') { host.to_owned() } else { format!("{host}:{PRIMARY_PORT}") };
        let unreachable = |error: io::Error| DescriptionFinding::Unreachable {
            address: address.clone(),
            why: error.to_string(),
        };
        let mut stream = TcpStream::connect(&address).map_err(unreachable)?;
        stream.set_read_timeout(Some(Duration::from_secs(WAIT_S))).map_err(unreachable)?;
        Self::receive(&mut stream).map_err(|error| {
            use io::ErrorKind::{TimedOut, UnexpectedEof, WouldBlock};
            if matches!(error.kind(), WouldBlock | TimedOut | UnexpectedEof) {
                DescriptionFinding::NoKinematics { address: address.clone(), wait_s: WAIT_S }
            } else {
                unreachable(error)
            }
        })
    }

    /// The table in the messages of a primary interface.
    ///
    /// # Errors
    /// The stream cannot be read, is not a stream of this interface, or has no table.
    pub fn receive(stream: &mut impl Read) -> io::Result<Self> {
        for _ in 0..MAX_MESSAGES {
            if let Some(table) = kinematics(&message(stream)?) {
                return Ok(Self::Whole(table));
            }
        }
        Err(io::ErrorKind::UnexpectedEof.into())
    }

    /// The robot of this type with the controller's table.
    ///
    /// # Errors
    /// The type is not one of Universal Robots with the maker's table, to which the differences belong.
    pub fn imported(&self, like: &Robot) -> Result<ImportedRobot, DescriptionFinding> {
        if !StandardTable::of(like).is_of_maker(like) {
            return Err(DescriptionFinding::OtherType { robot: like.name.clone() });
        }
        let mut robot = Robot { controller_model: ControllerModel::Calibrated, ..like.clone() };
        robot.source = Some("Geometry: the factory calibration of the controller.".into());
        let lines = match self {
            Self::Differences(table) => lines_after(&StandardTable::of(like).plus(table).links()),
            Self::Whole(table) => lines_after(&table.links()),
            Self::Segments(segments) => lines_before(segments),
        };
        Ok(lines.imported(robot, &like.frames.base))
    }
}

/// The lines of joints whose links follow them.
fn lines_after(links: &[Pose; AXES]) -> ArmLines {
    let mut frame = Pose::identity();
    let axes = links.map(|link| {
        let axis = JointAxis { point: frame.position, direction: frame.rotation.column(2).into() };
        frame = frame.then(&link);
        axis
    });
    ArmLines { axes, signs: [1.0; AXES], flange: frame }
}

/// The lines of joints that come before their segments.
fn lines_before(segments: &[Pose; AXES]) -> ArmLines {
    let mut frame = Pose::identity();
    let axes = segments.map(|segment| {
        frame = frame.then(&segment);
        JointAxis { point: frame.position, direction: frame.rotation.column(2).into() }
    });
    ArmLines { axes, signs: [1.0; AXES], flange: frame }
}

/// The six numbers of `key = [..]`.
fn six_numbers(text: &str, key: &str) -> Result<[f64; AXES], DescriptionFinding> {
    let value = text.lines().find_map(|line| line.trim().strip_prefix(key)?.trim_start().strip_prefix('='));
    let numbers = value.and_then(|value| {
        let list = value.trim().trim_start_matches('[').split(']').next()?;
        let numbers = list.split(',').map(|number| finite(number.trim()));
        numbers.collect::<Option<Vec<f64>>>()?.try_into().ok()
    });
    numbers.ok_or_else(|| DescriptionFinding::SixNumbers { key: key.into() })
}

/// The messages of the primary interface: a length of 4 bytes that includes itself, a type, and the rest (big endian).
fn message(stream: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut length = [0; 4];
    stream.read_exact(&mut length)?;
    let length = u32::from_be_bytes(length) as usize;
    if !(5..=MAX_MESSAGE).contains(&length) {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "this is not the primary interface"));
    }
    let mut message = vec![0; length - 4];
    stream.read_exact(&mut message)?;
    Ok(message)
}

/// The table in a message with the state of the robot. Each part of the message has a length of 4 bytes that includes
/// itself, and a type. The part with the kinematics has six checksums of 4 bytes, then theta, a, d and alpha of all
/// joints as 8-byte numbers, in m and rad: the whole table.
fn kinematics(message: &[u8]) -> Option<StandardTable> {
    let (&ROBOT_STATE, mut parts) = message.split_first()? else { return None };
    loop {
        let (length, _) = parts.split_first_chunk::<4>()?;
        let length = u32::from_be_bytes(*length) as usize;
        let part = parts.get(4..length)?;
        match part.split_first() {
            Some((&KINEMATICS, part)) => return standard_table(part.get(4 * AXES..)?),
            _ => parts = &parts[length..],
        }
    }
}

/// Four columns of six numbers.
fn standard_table(bytes: &[u8]) -> Option<StandardTable> {
    let (numbers, _) = bytes.as_chunks::<8>();
    let mut numbers = numbers.iter().map(|bytes| f64::from_be_bytes(*bytes));
    let mut column = |unit: f64| {
        let column: Vec<f64> = numbers.by_ref().take(AXES).map(|value| unit * value).collect();
        <[f64; AXES]>::try_from(column).ok().filter(|column| column.iter().all(|value| value.is_finite()))
    };
    Some(StandardTable { theta: column(1.0)?, a: column(1e3)?, d: column(1e3)?, alpha: column(1.0)? })
}

pub(super) fn finite(text: &str) -> Option<f64> {
    text.parse().ok().filter(|value: &f64| value.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbbd_model::estimation::Workspace;

    fn robot() -> Robot {
        Robot::by_name("ur10").unwrap().unwrap()
    }

    /// Differences as a controller has them: parallel axes 2 and 3 with offsets that cancel each other.
    const CONF: &str = "[mounting]\n\
        calibration_status = 2\n\
        delta_theta = [ 1.2e-05, -0.31, 0.33, -0.02, 3.2e-06, -5.0e-06 ]\n\
        delta_a = [ 4.1e-05, -0.0021, -0.0034, 3.8e-05, -1.9e-05, 0 ]\n\
        delta_d = [ 9.9e-05, 121.7, -128.2, 6.5, 1.1e-05, -2.0e-05 ]\n\
        delta_alpha = [ -2.0e-04, 1.9e-04, -3.1e-03, 6.2e-04, -1.8e-04, 0 ]\n";

    /// Independent computation of the flange: standard DH multiplied out, T = Rz(theta + q) Tz(d) Tx(a) Rx(alpha).
    fn flange(table: &StandardTable, angles: &[f64; AXES]) -> Pose {
        let mut frame = Pose::identity();
        for at in 0..AXES {
            let turn = Pose { rotation: rot_z(table.theta[at] + angles[at]), position: Vector3::zeros() };
            let up = Pose {
                position: Vector3::new(table.a[at], 0.0, table.d[at]),
                rotation: rot_x(table.alpha[at]),
            };
            frame = frame.then(&turn).then(&up);
        }
        frame
    }

    fn assert_same(imported: &ImportedRobot, expected: impl Fn(&[f64; AXES]) -> Pose) {
        assert!(imported.findings.is_empty(), "{:?}", imported.findings);
        assert!(imported.largest_mm < 1e-6, "{}", imported.largest_mm);
        for axes in Workspace::uniform(&imported.robot, 50, 3) {
            let found = imported.robot.geometry.flange(&axes);
            let expected = expected(&axes);
            assert!((found.position - expected.position).norm() < 1e-6, "{axes:?}");
            assert!(found.angle_to(&expected) < 1e-9);
        }
    }

    #[test]
    fn a_calibration_conf_is_added_to_the_nominal_table() {
        let table = FactoryTable::read(CONF).unwrap();
        let FactoryTable::Differences(differences) = table else { panic!("{table:?}") };
        assert_eq!((differences.d[1], differences.a[1]), (121_700.0, -2.1));
        let whole = StandardTable::of(&robot()).plus(&differences);
        let imported = table.imported(&robot()).unwrap();
        assert_same(&imported, |axes| flange(&whole, axes));
        assert_eq!(imported.robot.controller_model, ControllerModel::Calibrated);
        assert!(imported.robot.geometry.rows.iter().all(|row| row.d.abs() < 1000.0));
        // Without differences the result is the nominal robot.
        let zero = StandardTable { theta: [0.0; AXES], a: [0.0; AXES], d: [0.0; AXES], alpha: [0.0; AXES] };
        let same = FactoryTable::Differences(zero).imported(&robot()).unwrap();
        let nominal = robot().geometry.rows;
        for (row, nominal) in same.robot.geometry.rows.iter().zip(nominal) {
            assert!((row.a - nominal.a).abs() < 1e-9 && (row.d - nominal.d).abs() < 1e-9, "{row:?}");
            assert!((row.alpha - nominal.alpha).abs() < 1e-12 && (row.theta - nominal.theta).abs() < 1e-12);
        }
    }

    #[test]
    fn what_is_missing_in_a_conf_is_named() {
        let short = CONF.replace("delta_a = [ 4.1e-05,", "delta_a = [");
        assert_eq!(FactoryTable::read(&short), Err(DescriptionFinding::SixNumbers { key: "delta_a".into() }));
        let none = CONF.replace("delta_alpha", "alpha");
        assert_eq!(
            FactoryTable::read(&none),
            Err(DescriptionFinding::SixNumbers { key: "delta_alpha".into() })
        );
        assert_eq!(FactoryTable::read("robot = 3"), Err(DescriptionFinding::NotKnown));
    }

    /// The segments of the nominal UR10: each joint turns about the z of its segment.
    #[test]
    fn segments_of_a_yaml_are_the_places_of_the_joints() {
        let yaml = "kinematics:\n  shoulder:\n    x: 0\n    y: 0\n    z: 0.1273\n    roll: 0\n    pitch: 0\n    yaw: 0\n\
            \x20 upper_arm: {x: 0, y: 0, z: 0, roll: 1.5707963267948966, pitch: 0, yaw: 0}\n\
            \x20 forearm: {x: -0.612, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0}\n\
            \x20 wrist_1: {x: -0.5723, y: 0, z: 0.163941, roll: 0, pitch: 0, yaw: 0}\n\
            \x20 wrist_2: {x: 0, y: -0.1157, z: 0, roll: 1.5707963267948966, pitch: 0, yaw: 0}\n\
            \x20 wrist_3: {x: 0, y: 0.0922, z: 0, roll: -1.5707963267948966, pitch: 0, yaw: 0}\n\
            \x20 hash: calib_123\n";
        let nominal = robot().geometry;
        let imported = FactoryTable::read(yaml).unwrap().imported(&robot()).unwrap();
        assert_same(&imported, |axes| nominal.flange(axes));
        let cut = yaml.replace("pitch: 0, yaw: 0}\n  hash", "pitch: 0}\n  hash");
        assert_eq!(FactoryTable::read(&cut), Err(DescriptionFinding::Segment { segment: "wrist_3".into() }));
    }

    /// A message with another part before the kinematics, cut off at every byte.
    #[test]
    fn kinematics_are_found_in_the_state_of_the_robot() {
        let table = StandardTable::of(&robot());
        let mut part = vec![KINEMATICS];
        part.extend([0; 4 * AXES]);
        for (column, unit) in [(table.theta, 1.0), (table.a, 1e-3), (table.d, 1e-3), (table.alpha, 1.0)] {
            part.extend(column.iter().flat_map(|value| (unit * value).to_be_bytes()));
        }
        part.extend(1u32.to_be_bytes());
        let with_length = |bytes: &[u8]| [&(bytes.len() as u32 + 4).to_be_bytes()[..], bytes].concat();
        let body = [vec![ROBOT_STATE], with_length(&[0, 1, 2, 3]), with_length(&part)].concat();
        let found = kinematics(&body).unwrap();
        assert!((found.d[3] - 163.941).abs() < 1e-9 && (found.alpha[0] - table.alpha[0]).abs() < 1e-15);
        let whole = FactoryTable::Whole(found).imported(&robot()).unwrap();
        assert_same(&whole, |axes| robot().geometry.flange(axes));
        for cut in 0..body.len() - 4 {
            assert_eq!(kinematics(&body[..cut]), None, "{cut}");
        }
        assert_eq!(kinematics(&[ROBOT_STATE, 0, 0, 0, 0, 1]), None);
        let mut stream = &with_length(&body)[..];
        assert_eq!(message(&mut stream).unwrap(), body);
        assert!(message(&mut &[0xff; 8][..]).is_err());
    }
}
