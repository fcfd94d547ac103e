//! The geometry in the machine data of a KUKA controller (`$machine.dat`), with which the controller computes.
//!
//! From the base of the robot: `$TIRORO`, axis 1 about z, `$LENGTH_A` along x, axis 2 about y, `$LENGTH_B` along x,
//! axis 3 about y, `$TX3P3`, axis 4 about z, `$DH_4` (`Tz(D) Tx(A) Rx(ALPHA)`), axis 5 about z, `$DH_5`, axis 6 about
//! z, `$TFLWP`. `$AXIS_DIR` has the senses. (KUKA, *Machine Data* 12.04, 2005.) `$MAMES` is the position of the
//! mastering mark: it is part of the angle that an axis shows.

use dbbd_model::robot::pose::rot_x;
use dbbd_model::robot::{AXES, ArmTable, Geometry, JointAxis, Pose, Robot};
use nalgebra::Vector3;

use super::arm_lines::{ArmLines, ImportedRobot};
use super::catalogue::DescriptionFinding;
use super::universal::finite;
use super::urdf::USUAL_SPEED_DEG_S;

/// A frame: X, Y, Z in mm and A, B, C in degrees.
type Frame = [f64; 6];

/// Kinematics to which this formula applies: an arm with six axes and a wrist whose axes meet.
const NEEDED: [(&str, &str); 3] =
    [("$KINCLASS", "#STANDARD"), ("$MAIN_AXIS", "#NR"), ("$WRIST_AXIS", "#ZEH")];

/// A link of the wrist: `{DHART_A .., DHART_D .., DHART_ALPHA ..}`, mm and degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WristLink {
    pub a: f64,
    pub d: f64,
    pub alpha_deg: f64,
}

/// The values of `$machine.dat` on which the position of the flange depends.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineData {
    pub tiroro: Frame,
    pub length_a: f64,
    pub length_b: f64,
    pub tx3p3: Frame,
    pub dh_4: WristLink,
    pub dh_5: WristLink,
    pub tflwp: Frame,
    pub axis_dir: [f64; AXES],
}

impl MachineData {
    /// Whether a text has machine data.
    pub(super) fn is_in(text: &str) -> bool {
        value(text, "$TIRORO").is_some()
    }

    pub(super) fn read(text: &str) -> Result<Self, DescriptionFinding> {
        for (key, needed) in NEEDED {
            let found = value(text, key).ok_or_else(|| missing(key))?;
            if !found.eq_ignore_ascii_case(needed) {
                let (key, found, needed) = (key.into(), found.into(), needed.into());
                return Err(DescriptionFinding::OtherKinematics { key, found, needed });
            }
        }
        let frame = |key| parts(text, key, ["X", "Y", "Z", "A", "B", "C"]);
        let link = |key| {
            parts(text, key, ["DHART_A", "DHART_D", "DHART_ALPHA"]).map(|[a, d, alpha_deg]| WristLink {
                a,
                d,
                alpha_deg,
            })
        };
        let number = |key: &str| number(text, key);
        Ok(Self {
            tiroro: frame("$TIRORO")?,
            length_a: number("$LENGTH_A")?,
            length_b: number("$LENGTH_B")?,
            tx3p3: frame("$TX3P3")?,
            dh_4: link("$DH_4")?,
            dh_5: link("$DH_5")?,
            tflwp: frame("$TFLWP")?,
            axis_dir: of_axes(|axis| match number(&format!("$AXIS_DIR[{axis}]"))? {
                dir if dir.abs() == 1.0 => Ok(dir),
                _ => Err(missing(&format!("$AXIS_DIR[{axis}]"))),
            })?,
        })
    }

    /// The machine data of a KUKA with the table of this geometry; `None` if they do not describe the same arm.
    pub fn of(geometry: &Geometry) -> Option<Self> {
        let rows = &geometry.rows;
        let data = Self {
            tiroro: [0.0, 0.0, rows[0].d, 0.0, 0.0, 0.0],
            length_a: rows[1].a,
            length_b: rows[2].a,
            tx3p3: [rows[3].d, 0.0, rows[3].a, 0.0, 90.0, 0.0],
            dh_4: WristLink { a: 0.0, d: 0.0, alpha_deg: 90.0 },
            dh_5: WristLink { a: 0.0, d: 0.0, alpha_deg: -90.0 },
            tflwp: [0.0, 0.0, rows[5].d, 0.0, 0.0, 0.0],
            axis_dir: [-1.0, 1.0, 1.0, -1.0, -1.0, -1.0],
        };
        let is_same = |axes: [f64; AXES]| {
            let (expected, found) = (geometry.rigid().flange(&axes), data.flange(&axes));
            (found.position - expected.position).norm() < 1e-6 && found.angle_to(&expected) < 1e-9
        };
        let poses = [[0.0; AXES], [0.3, -0.8, 0.6, 1.1, -0.7, 2.0], [-2.0, -1.5, 2.0, -0.2, 1.4, -0.4]];
        poses.into_iter().all(is_same).then_some(data)
    }

    /// The flange in the robot base at axis angles (rad).
    pub fn flange(&self, axes: &[f64; AXES]) -> Pose {
        self.lines().flange_at(axes)
    }

    /// The same arm in modified DH, with the places of base and flange.
    pub fn table(&self) -> ArmTable {
        self.lines().table()
    }

    fn lines(&self) -> ArmLines {
        let along_x = |mm: f64| Pose { position: Vector3::x() * mm, ..Pose::identity() };
        let link = |link: &WristLink| Pose {
            rotation: rot_x(link.alpha_deg.to_radians()),
            position: Vector3::new(link.a, 0.0, link.d),
        };
        let (y, z) = (Vector3::y(), Vector3::z());
        // For each joint, the frame that leads to it, and its axis there.
        let joints = [
            (Pose::from_xyzabc(self.tiroro), z),
            (along_x(self.length_a), y),
            (along_x(self.length_b), y),
            (Pose::from_xyzabc(self.tx3p3), z),
            (link(&self.dh_4), z),
            (link(&self.dh_5), z),
        ];
        let mut frame = Pose::identity();
        let axes = joints.map(|(before, axis)| {
            frame = frame.then(&before);
            JointAxis { point: frame.position, direction: frame.rotation * axis }
        });
        let flange = frame.then(&Pose::from_xyzabc(self.tflwp));
        ArmLines { axes, signs: self.axis_dir, flange }
    }
}

/// The robot of a `$machine.dat`, with the limits of its axes and the speeds of its motors.
pub(super) fn import(text: &str) -> Result<ImportedRobot, DescriptionFinding> {
    let data = MachineData::read(text)?;
    let limits = of_axes(|axis| {
        let [low, high] = ["$SOFTN_END", "$SOFTP_END"].map(|key| number(text, &format!("{key}[{axis}]")));
        let (low, high) = (low?, high?);
        if low < high { Ok([low, high]) } else { Err(missing(&format!("$SOFTP_END[{axis}]"))) }
    })?;
    let speed = |axis: usize| {
        let per_minute = number(text, &format!("$VEL_AXIS_MA[{axis}]")).ok()?;
        let [n, d] = parts(text, &format!("$RAT_MOT_AX[{axis}]"), ["N", "D"]).ok()?;
        // Turns of the motor a minute in degrees/s of the axis.
        Some((per_minute * 6.0 * d / n).abs()).filter(|speed| speed.is_finite() && *speed > 0.0)
    };
    let speeds = std::array::from_fn(|at| speed(at + 1).unwrap_or(USUAL_SPEED_DEG_S));
    let name = value(text, "$TRAFONAME[]").unwrap_or_default();
    let name = format!("KUKA {}", name.trim_matches(['"', '#', ' ']));
    let mut robot = Robot::rigid(name.trim(), limits, speeds);
    robot.set_language(Some("krl"));
    robot.source = Some("Geometry, limits and speeds: the machine data of the controller.".into());
    // Controllers before KSS 5 may lack it.
    let root = value(text, "$ROBROOT").map(|_| parts(text, "$ROBROOT", ["X", "Y", "Z", "A", "B", "C"]));
    let world = root.transpose()?.map_or(Pose::identity(), Pose::from_xyzabc);
    Ok(data.lines().imported(robot, &world))
}

fn missing(key: &str) -> DescriptionFinding {
    DescriptionFinding::MachineValue { key: key.into() }
}

/// The values of an array with one value for each axis, which are numbered from 1.
fn of_axes<T: Copy + Default>(
    mut of: impl FnMut(usize) -> Result<T, DescriptionFinding>,
) -> Result<[T; AXES], DescriptionFinding> {
    let mut values = [T::default(); AXES];
    for (at, value) in values.iter_mut().enumerate() {
        *value = of(at + 1)?;
    }
    Ok(values)
}

/// The text after `key =`, without the comment.
fn value<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    text.lines().find_map(|line| {
        let (left, right) = line.split(';').next()?.split_once('=')?;
        left.split_whitespace().last()?.eq_ignore_ascii_case(key).then(|| right.trim())
    })
}

fn number(text: &str, key: &str) -> Result<f64, DescriptionFinding> {
    value(text, key).and_then(finite).ok_or_else(|| missing(key))
}

/// The numbers of `{NAME number, ..}`.
fn parts<const N: usize>(text: &str, key: &str, names: [&str; N]) -> Result<[f64; N], DescriptionFinding> {
    let of_name = |name: &str| {
        let list = value(text, key)?.trim_matches(['{', '}']);
        list.split(',').find_map(|part| {
            let (found, number) = part.trim().split_once(char::is_whitespace)?;
            found.eq_ignore_ascii_case(name).then(|| finite(number.trim()))?
        })
    };
    let mut numbers = [0.0; N];
    for (number, name) in numbers.iter_mut().zip(names) {
        *number = of_name(name).ok_or_else(|| missing(&format!("{name} of {key}")))?;
    }
    Ok(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbbd_model::estimation::Workspace;

    /// The machine data of a KR 60 HA by its data sheet, as a KR C4 writes them.
    const KR60HA: &str = "&ACCESS RVO\nDEFDAT $MACHINE PUBLIC\n\
        CHAR $TRAFONAME[32] ;NAME\n$TRAFONAME[]=\"#KR60HA C4 FLR\" ;\n\
        DECL KINCLASS $KINCLASS=#STANDARD ;KINEMATIKKLASSEN (STANDARD,SPECIAL)\n\
        DECL MAIN_AXIS $MAIN_AXIS=#NR ;GRUNDACHSENKENNUNG (SS = PORTAL)\nDECL WRIST_AXIS $WRIST_AXIS=#ZEH\n\
        $AXIS_DIR[1]=-1\n$AXIS_DIR[2]=1\n$AXIS_DIR[3]=1\n$AXIS_DIR[4]=-1\n$AXIS_DIR[5]=-1\n$AXIS_DIR[6]=-1\n\
        $SOFTN_END[1]=-185.0\n$SOFTN_END[2]=-135.0\n$SOFTN_END[3]=-120.0\n$SOFTN_END[4]=-350.0\n$SOFTN_END[5]=-119.0\n$SOFTN_END[6]=-350.0\n\
        $SOFTP_END[1]=185.0\n$SOFTP_END[2]=35.0\n$SOFTP_END[3]=158.0\n$SOFTP_END[4]=350.0\n$SOFTP_END[5]=119.0\n$SOFTP_END[6]=350.0\n\
        $VEL_AXIS_MA[1]=3100.0\n$RAT_MOT_AX[1]={N -184,D 1}\n$RAT_MOT_AX[2]={N 0,D 1}\n\
        FRAME $TIRORO={x 0.0,y 0.0,z 815.0,a 0.0,b 0.0,c 0.0} ;FRAME\n\
        FRAME $TFLWP={x 0.0,y 0.0,z 170.0,a 0.0,b 0.0,c 0.0}\nFRAME $TX3P3={x 820.0,y 0.0,z 145.0,a 0.0,b 90.0,c 0.0}\n\
        REAL $LENGTH_A=350.0 ;A\nREAL $LENGTH_B=850.0\n\
        DECL DHART $DH_4={DHART_A 0.0,DHART_D 0.0,DHART_ALPHA 90.0} ;A = LAENGE A\nDECL DHART $DH_5={DHART_A 0.0,DHART_D 0.0,DHART_ALPHA -90.0}\nENDDAT\n";

    /// The built-in table is from a paper, the machine data are from KUKA's manual: the same arm.
    #[test]
    fn machine_data_are_the_arm_of_the_table() {
        let ImportedRobot { robot, findings, largest_mm } = import(KR60HA).unwrap();
        let nominal = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        for axes in Workspace::uniform(&nominal, 200, 1) {
            let (expected, found) = (nominal.geometry.flange(&axes), robot.geometry.flange(&axes));
            assert!((found.position - expected.position).norm() < 1e-9 && found.angle_to(&expected) < 1e-12);
        }
        assert!(largest_mm < 1e-9 && findings.is_empty(), "{largest_mm} {findings:?}");
        assert_eq!((robot.name.as_str(), robot.limits_deg), ("KUKA KR60HA C4 FLR", nominal.limits_deg));
        // 3100 turns a minute through 184 : 1; a ratio of zero is none.
        assert!((robot.max_speed_deg_s[0] - 101.087).abs() < 1e-3);
        assert_eq!(robot.max_speed_deg_s[1], USUAL_SPEED_DEG_S);
        assert_eq!(robot.controller_language(), Some("krl"));
    }

    #[test]
    fn every_built_in_kuka_has_machine_data() {
        let mut kukas = 0;
        for (name, text) in Robot::built_in() {
            let robot = Robot::from_toml(name, text).unwrap();
            let is_kuka = robot.controller_language() == Some("krl");
            assert_eq!(MachineData::of(&robot.geometry).is_some(), is_kuka, "{name}");
            kukas += usize::from(is_kuka);
        }
        assert!(kukas >= 8, "{kukas}");
    }

    /// The wrist point of a KR 125 with A2 = -90 and A3 = 90: 410 + 1000 forward, 865 + 1000 + 45 up; the flange is 210
    /// further.
    #[test]
    fn offsets_have_the_directions_of_the_manual() {
        let data = MachineData {
            tiroro: [0.0, 0.0, 865.0, 0.0, 0.0, 0.0],
            length_a: 410.0,
            length_b: 1000.0,
            tx3p3: [1000.0, 0.0, 45.0, 0.0, 90.0, 0.0],
            tflwp: [0.0, 0.0, 210.0, 0.0, 0.0, 0.0],
            ..MachineData::read(KR60HA).unwrap()
        };
        let at = |deg: [f64; AXES]| data.flange(&deg.map(f64::to_radians));
        let home = at([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]);
        assert!((home.position - Vector3::new(1620.0, 0.0, 1910.0)).norm() < 1e-9);
        // KUKA's A1 turns clockwise from above; A5 tilts the flange down.
        assert!(
            (at([90.0, -90.0, 90.0, 0.0, 0.0, 0.0]).position - Vector3::new(0.0, -1620.0, 1910.0)).norm()
                < 1e-9
        );
        assert!(
            (at([0.0, -90.0, 90.0, 0.0, 90.0, 0.0]).position - Vector3::new(1410.0, 0.0, 1700.0)).norm()
                < 1e-9
        );
    }

    #[test]
    fn what_is_missing_or_of_another_arm_is_named() {
        let refused = |from: &str, to: &str| import(&KR60HA.replacen(from, to, 1)).unwrap_err();
        let value = |key: &str| DescriptionFinding::MachineValue { key: key.into() };
        for (from, to, key) in [
            ("$LENGTH_B", "$LENGTH_C", "$LENGTH_B"),
            ("850.0", "wide", "$LENGTH_B"),
            ("x 820.0", "u 820.0", "X of $TX3P3"),
            ("DHART_D 0.0,DHART_ALPHA 90.0", "DHART_ALPHA 90.0", "DHART_D of $DH_4"),
            ("$AXIS_DIR[4]=-1", "$AXIS_DIR[4]=2", "$AXIS_DIR[4]"),
            ("$SOFTP_END[2]=35.0", "$SOFTP_END[2]=-200.0", "$SOFTP_END[2]"),
            ("$KINCLASS", "$KIN", "$KINCLASS"),
        ] {
            assert_eq!(refused(from, to), value(key), "{to}");
        }
        let other = refused("$MAIN_AXIS=#NR", "$MAIN_AXIS=#CC");
        assert!(
            matches!(&other, DescriptionFinding::OtherKinematics { found, .. } if found == "#CC"),
            "{other:?}"
        );
    }
}
