//! Descriptions of robots that are not robot files.

use dbbd_model::findings;

findings! {
    /// A description that is no robot here, or whose frames a table cannot hold.
    DescriptionFinding "Importing a robot" {
        E1720 "a URDF cannot be read",
        cause: "The file is not XML, or its joints are not those of a six-axis arm: another number of joints, several arms, a sliding joint, a xacro file that was not expanded.",
        cure: "Expand xacro files (`xacro FILE > robot.urdf`). Name the six joints where the file has several chains.",
        asks: [UrdfJoints] {
            NotXml { why: String } => "{why}";
            NoSixJoints { chains: usize, joints: String } => "{chains} chains of six movable joints; exactly one is needed", help: "movable joints: {joints}";
            MoreJoints { sixth: String, joints: String } => "behind `{sixth}`, the sixth joint, others move: {joints}", help: "name the six joints of the arm if these are of a gripper; an arm with seven joints is not modelled";
            Xacro => "it is a xacro file, which was not expanded", help: "expand it: `xacro FILE > robot.urdf`";
            NoUrdf { root: String } => "its root is <{root}>, and that of a URDF is <robot>";
            NoSuchJoint { joint: String, joints: String } => "there is no movable joint `{joint}`", help: "movable joints: {joints}";
            OtherOrder { named: String } => "the joints {named} are not a chain in this order", help: "name them from the base to the flange";
            OtherCount { named: usize } => "{named} joints are named, and an arm has six";
            OtherJoint { joint: String, kind: String } => "joint `{joint}` is of type `{kind}`, and only turning joints are corrected";
            NotNumbers { attribute: String } => "`{attribute}` is not three numbers";
            NotNumber { attribute: String } => "`{attribute}` is not a number";
        }
        E0590 "a description of a controller cannot be read",
        cause: "The file is neither a URDF, nor the machine data of a KUKA ($machine.dat of R1), nor the calibration of a Universal Robots controller (calibration.conf, or YAML with `kinematics`); a value is missing in it; or its kinematics are not those of an arm with six axes and a central wrist.",
        cure: "Give the file of the controller as it is, or the address of the controller." {
            NotKnown => "is neither a URDF, nor a $machine.dat, nor a factory calibration of a known form";
            MachineValue { key: String } => "`{key}` is missing, or has no possible value";
            OtherKinematics { key: String, found: String, needed: String } => "`{key}` is {found}: only arms with {needed} are read";
            SixNumbers { key: String } => "`{key}` is missing, or is not six numbers";
            Segment { segment: String } => "`{segment}` of `kinematics` is missing, or lacks one of x, y, z, roll, pitch, yaw";
        }
        E0591 "the type of a calibrated robot is needed",
        cause: "A factory calibration has neither limits, speeds nor masses, and most have only the differences from the nominal table.",
        cure: "Name the built-in robot of the type, as ur10e, or its file.",
        asks: [Robot] {
            TypeNeeded => "is the calibration of a controller: the type of its robot is not given";
            OtherType { robot: String } => "is the calibration of a controller of Universal Robots, and {robot} has not the maker's table", help: "name a built-in robot, or a copy of its file with the lengths of yours";
        }
        E0592 "a controller does not send its table",
        cause: "The address is not the primary interface of a Universal Robots controller (port 30001), the network does not reach it, or its software is too old.",
        cure: "Check the address and the network, or give the controller's calibration.conf." {
            Unreachable { address: String, why: String } => "{address}: {why}";
            NoKinematics { address: String, wait_s: u64 } => "{address} did not send its kinematics within {wait_s} s";
        }
        W0593 "the controller counts from elsewhere than the table",
        cause: "A table in modified DH begins on the x axis of the base and ends on the last joint axis. The controller has its World or its flange beside it. The robot file says where ([mounting], [flange]): programs are written and corrected in the frames of the controller.",
        cure: "Give the places of base balls in the base of the robot, and the tool ball in the flange frame of its table. The difference is X,Y,Z in mm and A,B,C in degrees." {
            BaseElsewhere { frame: String } => "the base of the robot is at {frame} in the World of the controller";
            FlangeElsewhere { frame: String } => "the flange of the controller is at {frame} in the flange of the table";
        }
        W0594 "a description does not say what the controller shows",
        cause: "A URDF describes an arm, and not its controller. Makers differ in known ways: FANUC shows axis 3 against the horizontal and counts from the height of axis 2, Universal Robots turns the base by half a turn.",
        cure: "Name the maker, or give one pose as the pendant shows it: it decides, and proves the rest.",
        asks: [Maker, Coupled, PendantPose] {
            MakerUnknown => "the maker is not named: the axes are taken as the description has them", help: "the maker is abb, fanuc, kuka, staubli, universal, yaskawa or other";
            NoBaseLink { maker: &'static str } => "it has no link `base`, from which controllers of {maker} count: its first link is taken";
            Parallelogram { joint: String } => "joint `{joint}` follows another one (mimic), as in an arm with a parallelogram: axis 3 may be shown against the horizontal";
        }
        E0595 "the controller shows another pose",
        cause: "At the axis angles that were given, the flange of the description is elsewhere than the controller shows it: another robot, another zero of an axis, a tool or base that is not null on the pendant.",
        cure: "Show the pose with a null tool and a null base. Axis 3 is tried against axis 2 and against the horizontal.",
        asks: [PendantPose] {
            OtherPose { off_mm: f64, off_deg: f64 } => "the flange is {off_mm:.3} mm and {off_deg:.3} deg from where the controller shows it";
            NoPendantPose => "A1,..,A6=X,Y,Z or A1,..,A6=X,Y,Z,A,B,C are needed, in degrees and mm";
        }
    }
}
