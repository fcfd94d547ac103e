//! The sentences about a job.

use dbbd_model::findings;

findings! {
    /// What is wrong in a job.
    JobFinding "The job" {
        E0602 "two values of the job contradict each other",
        cause: "The lower end of a range is above the upper one, the margin leaves nothing of the stroke, or two base balls are at one place.",
        cure: "Give the lower end first: stroke_mm = [low, high], boxes by their lowest and their highest corner." {
            StrokeOrder { low_mm: f64, high_mm: f64, length_mm: f64 } => "stroke_mm = [{low_mm}, {high_mm}] must be [low, high], both less than the bar's length of {length_mm} mm";
            NoStrokeLeft { margin_mm: f64, stroke_mm: f64 } => "margin_mm = {margin_mm} must be at least 0 and leave some of the stroke of {stroke_mm} mm";
            BallsAtOnePlace { one: u32, other: u32 } => "base balls {one} and {other} are at one place: balls are at least 10 mm apart";
            CornersSwapped { key: String } => "{key}: the lowest corner must be below the highest one in X, Y and Z";
        }
        E0603 "a table or a key of the job is missing or one too many",
        cause: "Two keys exclude each other, or one needs another one beside it.",
        cure: "A goal has chosen poses; where they are measured is a point or a box. A circle has `plane` or `normal`. `cup_axis` and `cup_limit_deg` need each other. The table, the masses and all else of the arm are in the robot file. Only the orientations seed, random and optimal have `amplitude_deg`." {
            MissingTable { table: String } => "there is no {table} table: a job needs at least one";
            NoBarLength => "[bar] has no length_mm: the distance between the ball centres at reading zero";
            BallsAreOpen => "the base balls of this job are still to be chosen: only its goal can be planned", help: "plan the goal first; job.toml beside that plan has the balls";
            OnlyWithGoal => "places and bars to choose from need a [goal]", help: "give [goal] with position_mm, or give the balls as [[centre]] and the bar as [bar]";
            PointOrBox => "a [[place]] has either xyz_mm or box_mm";
            GoalTwice { other: String } => "[goal] has a program and {other}: a program has its own points and tools";
            GoalWithCircles => "a job with a [goal] has no [[circle]]: its poses are chosen";
            PlaneAndNormal { circle: usize } => "circle {circle}: has both `plane` and `normal`";
            NoPlane { circle: usize } => "circle {circle}: has neither `plane` nor `normal`";
            KeyOfRobot { key: String } => "`{key}` is a key of the robot file", help: "write it there: `robot` of the job names the file, and `dbbd robots show NAME` a built-in one";
            CupAlone { key: String, needed: String } => "{key} needs a {needed} beside it";
            NoAmplitude { circle: usize } => "circle {circle}: this orientation has no amplitude_deg";
        }
        E0604 "a number of a base ball is wrong",
        cause: "The `id` of the [[centre]] tables does not count 1, 2, .. in their order, or a circle names a ball that has no table.",
        cure: "Number the [[centre]] tables from 1 and let `centre` of each circle name one of them." {
            BallNumber { id: usize, expected: usize } => "id = {id} must be {expected}: base balls count from 1";
            NoSuchBall { circle: usize, centre: usize, balls: usize } => "circle {circle}: centre = {centre}: there are {balls} [[centre]] tables";
        }
        E0605 "a circle cannot be driven as the job says",
        cause: "A module holds 255 dwells with the reference poses. A continuous circle is one motion with one orientation, and the robot needs room to reach the feed.",
        cure: "Fewer points, or two circles instead of one; orientation = \"fixed\"; a longer `overshoot_deg` or a lower `feed_mm_s`." {
            DwellCount { circle: usize, points: u32, dwells: u32, most: u32 } => "circle {circle}: points = {points} are {dwells} dwells with the reference poses: a circle has at least 3 points and at most {most} dwells";
            NotFixed { circle: usize } => "circle {circle}: a continuous circle is one motion: it needs orientation = \"fixed\"";
            OvershootShort { circle: usize, overshoot_deg: f64, needed_deg: f64, feed_mm_s: f64 } => "circle {circle}: overshoot_deg = {overshoot_deg} is too short: the robot needs {needed_deg:.1} degrees to reach {feed_mm_s} mm/s";
        }
        E0606 "the digital outputs of the job are wrong",
        cause: "A controller has the outputs 1 to 4096. The index has eight neighbours, and the strobe must not be one of them.",
        cure: "Correct `outputs` in [motion], for example { strobe = 1, index = [9, 16] }." {
            Outputs { strobe: u32, first: u32, last: u32 } => "outputs: strobe = {strobe}, index = [{first}, {last}]: outputs are 1 to 4096, the index has eight";
            StrobeInIndex { strobe: u32 } => "outputs: the strobe {strobe} is one of the index";
        }
        E0607 "the job's frames contradict the robot file",
        cause: "`taught_deg` and `xyz_mm` of a base ball were not taken at one pose with the tool ball as $TOOL, or the tool ball is another one than [tool] ball_mm states.",
        cure: "Take both from the controller at one pose, with the tool ball as its tool, and measure [tool] `ball_mm` again." {
            TaughtElsewhere { ball: u32, x_mm: f64, y_mm: f64, z_mm: f64, off_mm: f64 } => "[[centre]] {ball}: taught_deg brings the tool ball to ({x_mm:.2}, {y_mm:.2}, {z_mm:.2}) mm, {off_mm:.2} mm from xyz_mm";
            ToolElsewhere { x_mm: f64, y_mm: f64, z_mm: f64, ball_x_mm: f64, ball_y_mm: f64, ball_z_mm: f64 } => "[motion] tool: its origin ({x_mm}, {y_mm}, {z_mm}) mm is not the tool ball ({ball_x_mm}, {ball_y_mm}, {ball_z_mm}) mm";
        }
        E0608 "the list of parameters in [optimise] cannot be used",
        cause: "A name is unknown, or the parameter is one for which no poses can be chosen (compliance, gear).",
        cure: "List names or the groups geometric, tool, centres and bar, as `dbbd identify` takes them." {
            Parameters { list: String, why: String } => "[optimise] parameters = \"{list}\": {why}";
            ParametersWithoutPrior { list: String } => "[optimise] parameters = \"{list}\": only geometric, tool, centres and bar can be listed";
        }
        I0681 "a part of the job has no effect",
        cause: "A base ball has no circle around it, so that it is not measured; or a floor is lower than the robot reaches, so that it has no effect.",
        cure: "Give the ball a circle or leave it out. Check the sign and the unit of z_mm: it is the height of the floor in the robot base, mm." {
            BallWithoutCircle { ball: u32 } => "base ball {ball} has no circle: it is not measured";
            FloorBelow { z_mm: f64, lowest_mm: f64 } => "the floor at {z_mm} mm is below the reach of the robot ({lowest_mm:.0} mm)";
        }
        W0682 "an obstacle encloses the robot's base",
        cause: "A floor, a box or a cylinder encloses a part of the robot's own base: its height, its corner or its frame is another one. The way is checked against this obstacle, so that the clearances of the plan are not those of the cell.",
        cure: "Obstacles are in the robot base, mm, whose origin is in the robot's foot. Correct the obstacle; a pedestal ends below the robot." {
            ObstacleInRobot { obstacle: usize, z_mm: f64 } => "[[obstacle]] {obstacle} encloses axis 1 of the robot, {z_mm:.0} mm above its foot";
        }
        W0683 "a dwell is too short for the bar",
        cause: "The bar is read at the rate of its protocol. A dwell with too few readings has no length.",
        cure: "Make dwell_s longer, or raise poll_hz of the definition if the device answers faster." {
            ShortDwell { dwell_s: f64, hz: f64, least: usize } => "dwell_s = {dwell_s}: at {hz} readings per second a dwell can have fewer than the {least} readings that a length needs";
        }
    }
}
