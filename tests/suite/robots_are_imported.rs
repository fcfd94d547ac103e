//! `dbbd robots import`: a URDF and the factory calibration of a controller become robot files.

use std::fs;
use std::io::Write;
use std::net::TcpListener;
use std::path::Path;

use dbbd_model::robot::{ControllerModel, Pose, Robot, max_axis_difference};
use tempfile::tempdir;

use crate::cell::{codes, dbbd, named, stderr};
use crate::nothing_wrong_is_silent::says;

/// The joints of a UR10 in a URDF, with the base that turns by half a turn as in those of its maker.
fn urdf() -> String {
    let origins = [
        ("0 0 0.1273", "0 0 0"),
        ("0 0 0", "1.570796326794897 0 0"),
        ("-0.612 0 0", "0 0 0"),
        ("-0.5723 0 0.163941", "0 0 0"),
        ("0 -0.1157 0", "1.570796326794897 0 0"),
        ("0 0.0922 0", "1.570796326794897 3.141592653589793 3.141592653589793"),
    ];
    let joint = |(at, (xyz, rpy)): (usize, &(&str, &str))| {
        format!(
            "<joint name='j{n}' type='revolute'><parent link='l{at}'/><child link='l{n}'/><origin xyz='{xyz}' rpy='{rpy}'/>\
             <axis xyz='0 0 1'/><limit lower='-6.28' upper='6.28' velocity='2.09' effort='1'/></joint>\n",
            n = at + 1
        )
    };
    let joints: String = origins.iter().enumerate().map(joint).collect();
    format!(
        "<robot name='arm'>\n<link name='base_link'/>\n<joint name='b' type='fixed'><parent link='base_link'/>\
         <child link='l0'/><origin xyz='0 0 0' rpy='0 0 3.141592653589793'/></joint>\n{joints}\
         <joint name='t' type='fixed'><parent link='l6'/><child link='tool0'/><origin xyz='0 0 0' rpy='0 0 0'/></joint>\n</robot>\n"
    )
}

fn read(path: &Path) -> Robot {
    Robot::from_toml("robot.toml", &fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn a_urdf_becomes_a_robot_with_the_same_flange() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("arm.urdf"), urdf()).unwrap();
    let output = dbbd(at, &["robots", "import", "arm.urdf", "--maker", "other", "--out", "arm.toml"]);
    assert_eq!((output.status.code(), codes(&output)), (Some(0), vec![]));
    let (robot, nominal) = (read(&at.join("arm.toml")), named("ur10"));
    assert!((robot.limits_deg[0][1] - 359.8).abs() < 0.1 && (robot.max_speed_deg_s[3] - 119.7).abs() < 0.1);
    let axes = [0.3, -1.2, 1.5, -0.7, 1.1, 0.4];
    // The base link is turned by half a turn against the controller's base.
    let turned = Pose::from_kuka([0.0; 3], [180.0, 0.0, 0.0]).then(&nominal.geometry.flange(&axes));
    let found = robot.geometry.flange(&axes);
    assert!((found.position - turned.position).norm() < 1e-6 && found.angle_to(&turned) < 1e-9, "{found:?}");
    // It can be planned with.
    assert_eq!(dbbd(at, &["robots", "check", "arm.toml"]).status.code(), Some(0));
    // An inclined base has no place in a table.
    fs::write(at.join("wall.urdf"), urdf().replace("rpy='0 0 3.141592653589793'", "rpy='0.5 0.2 0'"))
        .unwrap();
    says(&dbbd(at, &["robots", "import", "wall.urdf", "--out", "wall.toml"]), 3, "W0593");
    // A seventh joint: an arm of seven, or a gripper.
    let seventh = "<link name='l7'/><joint name='j7' type='revolute'><parent link='tool0'/><child link='l7'/>\
                   <axis xyz='0 0 1'/></joint></robot>";
    fs::write(at.join("more.urdf"), urdf().replace("</robot>", seventh)).unwrap();
    says(&dbbd(at, &["robots", "import", "more.urdf", "--out", "no.toml"]), 1, "E1720");
    let named = ["robots", "import", "more.urdf", "--joints", "j1,j2,j3,j4,j5,j6", "--out", "more.toml"];
    says(&dbbd(at, &named), 3, "W0594");
    for (from, to) in
        [("revolute", "prismatic"), ("<robot", "<model"), ("velocity='2.09'", "velocity='fast'")]
    {
        let wrong = urdf()
            .replace(from, to)
            .replace("</robot", &format!("</{}", if to == "<model" { "model" } else { "robot" }));
        fs::write(at.join("wrong.urdf"), wrong).unwrap();
        says(&dbbd(at, &["robots", "import", "wrong.urdf", "--out", "no.toml"]), 1, "E1720");
    }
    says(&dbbd(at, &["robots", "import", "arm.urdf", "--out", "arm.urdf", "--replace"]), 1, "E0180");
    assert!(!at.join("no.toml").exists() && fs::read_to_string(at.join("arm.urdf")).unwrap() == urdf());
}

/// A joint of a URDF: its place in the link before, mm in m, and its axis.
type UrdfRow = (&'static str, &'static str, &'static str);

/// A URDF as makers write them: `base` is where the controller counts from, `tool0` its flange.
fn of_maker(name: &str, base: (&str, &str), rows: [UrdfRow; 6], tool0: (&str, &str)) -> String {
    let fixed = |child: &str, parent: &str, (xyz, rpy): (&str, &str)| {
        format!(
            "<link name='{child}'/><joint name='{child}_fixed' type='fixed'><parent link='{parent}'/><child link='{child}'/>\
             <origin xyz='{xyz}' rpy='{rpy}'/></joint>\n"
        )
    };
    let joint = |(at, (xyz, rpy, axis)): (usize, &UrdfRow)| {
        let parent = if at == 0 { "base_link".to_owned() } else { format!("l{at}") };
        format!(
            "<link name='l{n}'/><joint name='j{n}' type='revolute'><parent link='{parent}'/><child link='l{n}'/><origin xyz='{xyz}' rpy='{rpy}'/>\
             <axis xyz='{axis}'/><limit lower='-3' upper='3' velocity='2' effort='1'/></joint>\n",
            n = at + 1
        )
    };
    let joints: String = rows.iter().enumerate().map(joint).collect();
    let (base, tool0) = (fixed("base", "base_link", base), fixed("tool0", "l6", tool0));
    format!("<robot name='{name}'><link name='base_link'/>{base}{joints}{tool0}</robot>")
}

/// The M-20iD/25 by the lengths of its maker's description: World is 425 mm above the foot, and joint 3 turns against axis 2.
fn fanuc(name: &str) -> String {
    let rows = [
        ("0 0 0.425", "0 0 0", "0 0 1"),
        ("0.075 0 0", "0 0 0", "0 1 0"),
        ("0 0 0.84", "0 0 0", "0 -1 0"),
        ("0 0 0.215", "0 0 0", "-1 0 0"),
        ("0.89 0 0", "0 0 0", "0 -1 0"),
        ("0 0 0", "0 0 0", "-1 0 0"),
    ];
    of_maker(name, ("0 0 0.425", "0 0 0"), rows, ("0.09 0 0", "3.141592653589793 -1.5707963267948966 0"))
}

/// The UR5e by its maker's default kinematics: the base is turned by half a turn.
fn universal(name: &str) -> String {
    let rows = [
        ("0 0 0.1625", "0 0 3.141592653589793", "0 0 1"),
        ("0 0 0", "1.5707963267948966 0 0", "0 0 1"),
        ("-0.425 0 0", "0 0 0", "0 0 1"),
        ("-0.3922 0 0.1333", "0 0 0", "0 0 1"),
        ("0 -0.0997 0", "1.5707963267948966 0 0", "0 0 1"),
        ("0 0.0996 0", "1.5707963267948966 3.141592653589793 3.141592653589793", "0 0 1"),
    ];
    of_maker(name, ("0 0 0", "0 0 3.141592653589793"), rows, ("0 0 0", "0 0 0"))
}

/// Whether two robots show the same flange at the same angles of the pendant.
fn assert_same_controller(found: &Robot, expected: &Robot) {
    for axes_deg in
        [[0.0; 6], [10.0, 40.0, -20.0, 5.0, -60.0, 7.0], [-70.0, -30.0, 35.0, 100.0, 50.0, -120.0]]
    {
        let flange = |robot: &Robot| {
            let table = robot.geometry.rigid().flange(&axes_deg.map(f64::to_radians));
            robot.frames.base.then(&table).then(&robot.frames.flange)
        };
        let (found, expected) = (flange(found), flange(expected));
        assert!((found.position - expected.position).norm() < 1e-3, "{axes_deg:?}: {found:?} {expected:?}");
        assert!(found.angle_to(&expected) < 1e-6, "{axes_deg:?}: {found:?} {expected:?}");
    }
}

/// A description becomes the robot of its controller: base, flange, coupling, language and model are the maker's.
#[test]
fn a_urdf_becomes_the_robot_of_its_controller() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let import = |text: &str, more: &[&str]| {
        fs::write(at.join("arm.urdf"), text).unwrap();
        dbbd(at, &[&["robots", "import", "arm.urdf", "--out", "arm.toml", "--replace"], more].concat())
    };
    let imported = || read(&at.join("arm.toml"));
    assert_eq!(import(&fanuc("fanuc_m20id25"), &[]).status.code(), Some(0));
    assert_same_controller(&imported(), &named("m20id25"));
    assert_eq!(imported().controller_language(), Some("fanuc"));
    assert_eq!(import(&universal("ur5e_robot"), &[]).status.code(), Some(0));
    assert_same_controller(&imported(), &named("ur5e"));
    assert_eq!(
        (imported().controller_language(), imported().controller_model),
        (Some("urscript"), ControllerModel::Unknown)
    );
    // Files of the shapes name the maker too.
    let shape = "<link name='base_link'><visual><geometry><mesh filename='package://fanuc_support/m.stl'/></geometry></visual></link>";
    assert_eq!(
        import(&fanuc("m20").replacen("<link name='base_link'/>", shape, 1), &[]).status.code(),
        Some(0)
    );
    assert_same_controller(&imported(), &named("m20id25"));
    // Who made it is asked where nothing says it; a pose of the pendant decides how axis 3 is shown.
    says(&import(&fanuc("arm"), &[]), 3, "W0594");
    assert_eq!(import(&fanuc("arm"), &["--maker", "fanuc"]).status.code(), Some(0));
    assert_same_controller(&imported(), &named("m20id25"));
    let shown = "10,40,-20,5,-60,7=1518.31,260.82,452.76";
    assert_eq!(import(&fanuc("arm"), &["--at", shown]).status.code(), Some(0));
    assert_same_controller(&imported(), &named("m20id25"));
    says(&import(&fanuc("arm"), &["--at", "10,40,-20,5,-60,7=1500,260,452"]), 1, "E0595");
    says(&import(&fanuc("arm"), &["--at", "10,40,-20=1500,260,452"]), 2, "E0595");
    // What the description lacks is named.
    says(&import(&universal("ur5e").replace("'base'", "'foot'"), &[]), 3, "W0594");
    says(
        &import(
            &fanuc("abb").replacen("<axis xyz='0 -1 0'/>", "<axis xyz='0 -1 0'/><mimic joint='j2'/>", 1),
            &[],
        ),
        3,
        "W0594",
    );
    let answered = import(
        &fanuc("abb").replacen("<axis xyz='0 -1 0'/>", "<axis xyz='0 -1 0'/><mimic joint='j2'/>", 1),
        &["--coupled", "yes"],
    );
    assert_eq!(answered.status.code(), Some(0), "{}", stderr(&answered));
    assert!(!imported().geometry.coupling.is_none());
    // ABB's arms with a parallelogram are coupled as well, with axes of equal sense the other way round.
    let abb = |name: &str| fanuc(name).replacen("<axis xyz='0 -1 0'/>", "<axis xyz='0 1 0'/>", 1);
    assert_eq!(import(&abb("abb_irb2400"), &[]).status.code(), Some(0));
    assert_eq!(imported().geometry.coupling.joints(&[0.0, 0.4, 0.3, 0.0, 0.0, 0.0])[2], 0.3 - 0.4);
    assert_eq!(import(&abb("abb_irb6640"), &[]).status.code(), Some(0));
    assert!(imported().geometry.coupling.is_none());
    let xacro = import(
        "<robot xmlns:xacro='http://www.ros.org/wiki/xacro' name='a'><xacro:macro name='m'/></robot>",
        &[],
    );
    says(&xacro, 1, "E1720");
    assert!(stderr(&xacro).contains("not expanded"), "{}", stderr(&xacro));
    // A factory calibration belongs to the maker's table, which the maker's URDF gives.
    assert_eq!(import(&universal("ur5e_robot"), &[]).status.code(), Some(0));
    fs::write(at.join("calibration.conf"), CONF).unwrap();
    let of_type = |robot: &str, out: &str| {
        dbbd(at, &["robots", "import", "calibration.conf", "--robot", robot, "--out", out])
    };
    assert_eq!(of_type("arm.toml", "mine.toml").status.code(), Some(0));
    assert_eq!(of_type("ur5e", "built-in.toml").status.code(), Some(0));
    assert_same_controller(&read(&at.join("mine.toml")), &read(&at.join("built-in.toml")));
    says(&of_type("kr60ha", "no.toml"), 1, "E0591");
    // An arm on a wall remains one.
    let text = fs::read_to_string(at.join("arm.toml")).unwrap();
    fs::write(at.join("wall.toml"), format!("{text}\n[mounting]\ngravity = [0.0, 1.0, 0.0]\n")).unwrap();
    assert_eq!(of_type("wall.toml", "on-wall.toml").status.code(), Some(0));
    assert_eq!(read(&at.join("on-wall.toml")).geometry.load.gravity, nalgebra::Vector3::y());
}

/// What dbbd exports, it imports: each built-in robot comes back as the same controller, without a question; also one that stands elsewhere, whose
/// other flange the table takes up.
#[test]
fn an_exported_urdf_comes_back() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let frames = dbbd_model::robot::ControllerFrames {
        base: Pose::from_kuka([200.0, -100.0, 500.0], [30.0, 0.0, 0.0]),
        flange: Pose::from_kuka([0.0, 0.0, 12.0], [0.0, 0.0, 180.0]),
    };
    let built_in =
        Robot::built_in().iter().map(|(name, _)| (*name, Robot::by_name_with_tool(name, [30.0, 20.0, 10.0])));
    let robots: Vec<(&str, Robot)> = built_in.map(|(name, robot)| (name, robot.unwrap().unwrap())).collect();
    let elsewhere = ("kr60ha", Robot { frames, ..named("kr60ha") });
    for (name, robot) in robots.into_iter().chain([elsewhere]) {
        let known = Robot { nominal: Some(Box::new(robot.clone())), ..robot.clone() };
        fs::write(at.join("id.toml"), known.to_toml().unwrap()).unwrap();
        let exported = dbbd(at, &["export", "id.toml", "--for", "urdf", "--out", "urdf", "--replace"]);
        assert!(matches!(exported.status.code(), Some(0 | 3)), "{name}: {}", stderr(&exported));
        let urdf = ["robots", "import", "urdf/robot-identified.urdf", "--out", "back.toml", "--replace"];
        let back = dbbd(at, &urdf);
        let wanted =
            if robot.frames == frames { (Some(3), vec!["W0593".to_owned()]) } else { (Some(0), vec![]) };
        assert_eq!((back.status.code(), codes(&back)), wanted, "{name}: {}", stderr(&back));
        assert_same_controller(&read(&at.join("back.toml")), &robot);
    }
}

/// `$ROBROOT` is where the robot stands in its World.
#[test]
fn machine_data_say_where_the_robot_stands() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let data = "DEFDAT $MACHINE PUBLIC\nDECL KINCLASS $KINCLASS=#STANDARD\nDECL MAIN_AXIS $MAIN_AXIS=#NR\nDECL WRIST_AXIS $WRIST_AXIS=#ZEH\n\
        FRAME $ROBROOT={X 0.0,Y 0.0,Z 500.0,A 90.0,B 0.0,C 0.0}\nFRAME $TIRORO={X 0.0,Y 0.0,Z 815.0,A 0.0,B 0.0,C 0.0}\n\
        FRAME $TFLWP={X 0.0,Y 0.0,Z 170.0,A 0.0,B 0.0,C 0.0}\nFRAME $TX3P3={X 820.0,Y 0.0,Z 145.0,A 0.0,B 90.0,C 0.0}\n\
        REAL $LENGTH_A=350.0\nREAL $LENGTH_B=850.0\nDECL DHART $DH_4={DHART_A 0.0,DHART_D 0.0,DHART_ALPHA 90.0}\n\
        DECL DHART $DH_5={DHART_A 0.0,DHART_D 0.0,DHART_ALPHA -90.0}\n";
    let of_axis = |axis: usize| {
        let sense = if [2, 3].contains(&axis) { 1 } else { -1 };
        format!("$AXIS_DIR[{axis}]={sense}\n$SOFTN_END[{axis}]=-120.0\n$SOFTP_END[{axis}]=120.0\n")
    };
    let data = format!("{data}{}ENDDAT\n", (1..=6).map(of_axis).collect::<String>());
    fs::write(at.join("$machine.dat"), &data).unwrap();
    says(&dbbd(at, &["robots", "import", "$machine.dat", "--out", "k.toml"]), 3, "W0593");
    let robot = read(&at.join("k.toml"));
    let expected = Pose::from_kuka([0.0, 0.0, 500.0], [90.0, 0.0, 0.0]);
    assert!((robot.frames.base.position - expected.position).norm() < 1e-9);
    assert!(robot.frames.base.angle_to(&expected) < 1e-9);
    fs::write(at.join("$machine.dat"), data.replace("Z 500.0,A 90.0", "Z 0.0,A 0.0")).unwrap();
    let upright = dbbd(at, &["robots", "import", "$machine.dat", "--out", "k.toml", "--replace"]);
    assert_eq!(upright.status.code(), Some(0), "{}", stderr(&upright));
    assert_eq!(read(&at.join("k.toml")).frames, dbbd_model::robot::ControllerFrames::default());
    // A wall: gravity follows from the place, and another one contradicts it.
    let text = fs::read_to_string(at.join("k.toml")).unwrap();
    let with = |table: &str| Robot::from_toml("k.toml", &format!("{text}\n[mounting]\n{table}\n"));
    let wall = with("abc_deg = [0.0, 90.0, 0.0]").unwrap();
    assert!(
        (wall.geometry.load.gravity - nalgebra::Vector3::x()).norm() < 1e-9,
        "{}",
        wall.geometry.load.gravity
    );
    assert!(with("abc_deg = [0.0, 90.0, 0.0]\ngravity = [1.0, 0.0, 0.0]").is_ok());
    assert_eq!(
        with("abc_deg = [0.0, 90.0, 0.0]\ngravity = [0.0, 0.0, -1.0]").unwrap_err().code().to_string(),
        "E0505"
    );
    assert_eq!(with("xyz_mm = [0.0, 0.0, 500000.0]").unwrap_err().code().to_string(), "E0130");
}

#[test]
fn a_built_in_robot_becomes_a_file() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let import = || dbbd(at, &["robots", "import", "kr60ha", "--out", "mine.toml"]);
    assert_eq!(import().status.code(), Some(0));
    assert_eq!(read(&at.join("mine.toml")), Robot::by_name("kr60ha").unwrap().unwrap());
    // What applies to others is not ignored, and a mistyped name is not taken for a file.
    for more in [["--robot", "ur10"], ["--joints", "a,b"]] {
        let import = ["robots", "import", "kr60ha", "--out", "other.toml"];
        says(&dbbd(at, &[&import[..], &more].concat()), 1, "E1982");
    }
    let mistyped = dbbd(at, &["robots", "import", "kr60a", "--out", "other.toml"]);
    says(&mistyped, 1, "E0503");
    assert!(stderr(&mistyped).contains("did you mean `kr60ha`?"), "{}", stderr(&mistyped));
    assert!(!at.join("other.toml").exists());
    // A file that somebody has changed since is kept.
    fs::write(at.join("mine.toml"), "serial = \"4711\"").unwrap();
    says(&import(), 1, "E0182");
    assert_eq!(fs::read_to_string(at.join("mine.toml")).unwrap(), "serial = \"4711\"");
}

const CONF: &str = "[mounting]\ndelta_theta = [0.0004, 0, 0, 0, 0, 0]\ndelta_a = [0, 0.0009, 0, 0, 0, 0]\n\
    delta_d = [0, 0, 0, 0, 0, 0]\ndelta_alpha = [0, 0, 0, 0, 0, 0]\n";

#[test]
fn a_factory_calibration_is_the_table_of_the_controller() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("calibration.conf"), CONF).unwrap();
    let import = |from: &str, more: &[&str]| {
        dbbd(at, &[&["robots", "import", from, "--out", "mine.toml", "--replace"][..], more].concat())
    };
    says(&import("calibration.conf", &[]), 1, "E0591");
    let like = ["--robot", "ur10"];
    assert_eq!(import("calibration.conf", &like).status.code(), Some(0));
    let robot = read(&at.join("mine.toml"));
    assert_eq!(robot.controller_model, ControllerModel::Calibrated);
    assert!((robot.geometry.rows[2].a - (-612.0 + 0.9)).abs() < 1e-9);
    assert!((robot.geometry.rows[0].theta - 0.0004).abs() < 1e-12);
    assert_eq!(robot.geometry.load, named("ur10").geometry.load);
    fs::write(at.join("short.conf"), CONF.replace("delta_d = [0,", "delta_d = [")).unwrap();
    says(&import("short.conf", &like), 1, "E0590");
    says(&import("ur://127.0.0.1:1", &like), 1, "E0592");
    let joints = ["--robot", "ur10", "--joints", "a,b,c,d,e,f"];
    says(&import("calibration.conf", &joints), 1, "E1982");
    says(&import("ur://127.0.0.1:1", &joints), 1, "E1982");
    fs::write(at.join("arm.urdf"), urdf()).unwrap();
    says(&import("arm.urdf", &like), 1, "E1982");
}

/// The state of a robot as the primary interface sends it, with the table of the UR10 e as it is made.
#[test]
fn a_controller_is_asked_for_its_table() {
    let nominal = named("ur10e");
    let rows = &nominal.geometry.rows;
    let next = |at: usize, of: fn(&dbbd_model::robot::DhRow) -> f64| rows.get(at + 1).map_or(0.0, of);
    let mut part = vec![5];
    part.extend([7; 24]);
    let columns: [[f64; 6]; 4] = [
        [0.01, 0.0, 0.0, 0.0, 0.0, 0.0],
        std::array::from_fn(|at| 1e-3 * next(at, |row| row.a)),
        std::array::from_fn(|at| 1e-3 * rows[at].d),
        std::array::from_fn(|at| next(at, |row| row.alpha)),
    ];
    part.extend(columns.iter().flatten().flat_map(|value| value.to_be_bytes()));
    let with_length = |bytes: &[u8]| [&(bytes.len() as u32 + 4).to_be_bytes()[..], bytes].concat();
    // The version comes first, then a state.
    let state = with_length(&[&[16][..], &with_length(&part)].concat());
    let version = with_length(&[20, 1, 2, 3]);
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let controller = std::thread::spawn(move || {
        let (mut client, _) = listener.accept().unwrap();
        client.write_all(&[version, state].concat()).unwrap();
    });
    let dir = tempdir().unwrap();
    let from = format!("ur://{address}");
    let output = dbbd(dir.path(), &["robots", "import", &from, "--robot", "ur10e", "--out", "mine.toml"]);
    assert_eq!((output.status.code(), codes(&output)), (Some(0), vec![]));
    controller.join().unwrap();
    let robot = read(&dir.path().join("mine.toml"));
    let turned = [0.3, -1.2, 1.5, -0.7, 1.1, 0.4];
    let mut axes = turned;
    axes[0] += 0.01;
    let [found, expected] = [robot.geometry.flange(&turned), nominal.geometry.flange(&axes)];
    assert!((found.position - expected.position).norm() < 1e-6, "{found:?}");
    assert!(max_axis_difference(&turned, &axes) > 0.009);
}
