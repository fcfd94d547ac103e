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
        }
        E0592 "a controller does not send its table",
        cause: "The address is not the primary interface of a Universal Robots controller (port 30001), the network does not reach it, or its software is too old.",
        cure: "Check the address and the network, or give the controller's calibration.conf." {
            Unreachable { address: String, why: String } => "{address}: {why}";
            NoKinematics { address: String, wait_s: u64 } => "{address} did not send its kinematics within {wait_s} s";
        }
        W0593 "a frame of the table is elsewhere than that of the description",
        cause: "A table in modified DH begins on the x axis of the base and ends on the last joint axis. The description has its base or its last link beside it.",
        cure: "Give base balls, frames and tools in the frames of the table. The difference is X,Y,Z in mm and A,B,C in degrees." {
            BaseElsewhere { frame: String } => "the base of the table is at {frame} in the base of the description";
            FlangeElsewhere { frame: String } => "the last link of the description is at {frame} in the flange of the table";
        }
    }
}
