//! Plans: refused, staged, read back, and what would help.

use dbbd_model::findings;

findings! {
    /// What the planner finds. `quantity` has the name and the unit that `checks` in plan.json have.
    PlanFinding "The plan" {
        E0722 "there are no poses to measure again",
        cause: "Every pose of the runs has a length, a row that is named does not exist, or the outliers of something other than a result are asked for.",
        cure: "Name other runs or rows; outliers are those of a result's directory.",
        asks: [Remaining, Repeat] {
            NothingRemains => "no pose is left to be measured";
            NoSuchRow { index: u32 } => "there is no pose to be measured with the index {index}";
            OutliersWithoutResult => "only a result has outliers", help: "name the directory of `dbbd identify`";
        }
        E0701 "a plan is refused",
        cause: "At least one pose or path is unsafe or impossible. The findings before this one name rows, quantities and limits.",
        cure: "See the cures of those findings. Nothing was written." {
            Refused { findings: usize, shown: usize } => "the plan is refused: {findings} findings, the first {shown} are shown";
        }
        E0702 "a pose or a path cannot be reached",
        cause: "The pose is farther than the arm, or the arm would have to change its configuration while the bar is on.",
        cure: "Turn or tilt the tool (`tilt_deg`, `spin_deg`), make `amplitude_deg` smaller, plan an arc instead of a full circle, or move the base ball." {
            Unreachable { row: u32, x_mm: f64, y_mm: f64, z_mm: f64, why: String } => "row {row}: at ({x_mm:.1}, {y_mm:.1}, {z_mm:.1}) mm: {why}";
            BranchLeft { row: u32, began: u8, became: u8 } => "row {row}: the arm changes its configuration on the way: status {became}, must stay {began}";
            FirstPointUnreachable { circle: u32 } => "circle {circle}: its first point cannot be reached within the limits";
            NoOrientation { circle: u32, angle_deg: f64 } => "circle {circle}: at {angle_deg:.0} degrees no turn of the tool within amplitude_deg keeps the limits and the stroke";
        }
        E0703 "an axis limit or a singularity is too near",
        cause: "An axis comes to its limit, the wrist (A5 = 0) or the elbow is nearly straight, the wrist is above axis 1, or an axis turns over on the path.",
        cure: "Turn or tilt the tool (`tilt_deg`, `spin_deg`), make `amplitude_deg` smaller, plan an arc instead of a full circle, or move the base ball." {
            ArmBelow { row: u32, quantity: String, worst: f64, limit: f64 } => "row {row}: {quantity} = {worst:.3}, must be at least {limit:.3}";
            ArmAbove { row: u32, quantity: String, worst: f64, limit: f64 } => "row {row}: {quantity} = {worst:.3}, must be at most {limit:.3}";
        }
        E0704 "an axis is too fast",
        cause: "The axes cannot follow the path at the speeds and accelerations of the robot file.",
        cure: "Lower `feed_mm_s` and `turn_deg_s`, keep away from singularities, or correct the limits in the robot file." {
            TooFast { row: u32, quantity: String, worst: f64, limit: f64 } => "row {row}: {quantity} = {worst:.3}, must be at most {limit:.3}";
        }
        E0705 "a reading would leave the stroke",
        cause: "The radius of the circle does not fit the length of the bar, its stroke and `margin_mm`.",
        cure: "Correct `radius_mm`, `length_mm` or `stroke_mm`. Never widen the stroke beyond that of the bar." {
            ReadingBelow { row: u32, quantity: String, worst: f64, limit: f64 } => "row {row}: {quantity} = {worst:.3}, must be at least {limit:.3}";
            ReadingAbove { row: u32, quantity: String, worst: f64, limit: f64 } => "row {row}: {quantity} = {worst:.3}, must be at most {limit:.3}";
        }
        E0706 "the risk that a reading leaves the stroke is too great",
        cause: "The robot is not known well enough for this stroke: one within its tolerance might leave it.",
        cure: "Measure a stage of safe poses first (examples/stages/run.sh), teach the ball as `taught_deg` says, or use a bar with a longer stroke.",
        asks: [Stage] {
            StrokeRisk { row: u32, quantity: String, worst: f64, limit: f64 } => "row {row}: {quantity} = {worst:.1e}, must be at most {limit:.1e}";
        }
        E0707 "the bar leans too far from a cup",
        cause: "The angle between the bar and the axis of a cup is greater than `cup_limit_deg`.",
        cure: "Another plane or an arc instead of a full circle, or another direction of the cup. Never widen the limit beyond that of the cup." {
            CupAngle { row: u32, quantity: String, worst: f64, limit: f64 } => "row {row}: {quantity} = {worst:.3}, must be at most {limit:.3}";
        }
        E0708 "an obstacle is too near",
        cause: "The bar, the tool or a link of the arm comes nearer to an [[obstacle]] than `min_clearance_mm`.",
        cure: "Move the base ball or the obstacle, plan an arc, or correct the radii in [tool] and [bar]." {
            Obstacle { row: u32, quantity: String, worst: f64, limit: f64 } => "row {row}: {quantity} = {worst:.3}, must be at least {limit:.3}";
        }
        E0710 "too few poses can be chosen",
        cause: "Most poses are out of reach, or the robot within its tolerance might leave the stroke there.",
        cure: "Measure a stage first (`stage_points`, examples/stages/run.sh), teach the ball as `taught_deg` says, use a bar with a longer stroke, or move the base ball." {
            TooFewPoses { allowed: usize, wanted: usize } => "{allowed} poses are within the limits and the stroke, {wanted} are wanted";
            NoPose { ball: u32 } => "no pose about base ball {ball} can be reached within the limits";
            NoSafeStart { ball: u32 } => "no pose about base ball {ball} is safe enough to start from as the robot is known now";
            NoPath => "none of the chosen poses can be reached from another one";
        }
        I0711 "some poses were left out",
        cause: "They are out of reach, or no path to them keeps the limits.",
        cure: "Nothing to do if the prediction suffices. Else move the base ball, or allow more `candidates`." {
            FewCandidates { ball: u32, found: usize, wanted: usize } => "base ball {ball}: {found} of {wanted} candidates can be reached within the limits";
            NothingChosen { ball: u32 } => "base ball {ball}: no pose about it was worth choosing";
            PosesLeftOut { ball: u32, left_out: usize, chosen: usize } => "base ball {ball}: {left_out} of {chosen} chosen poses were left out: no path to them keeps the limits";
            ReferencesLeftOut { ball: u32, left_out: usize } => "base ball {ball}: {left_out} visits of the reference pose were left out";
        }
        I0712 "poses are excluded because the robot is not known well enough",
        cause: "As the robot is known now, their length might leave the stroke.",
        cure: "Measure this plan, identify, and plan again with robot-identified.toml, until no stage is needed.",
        asks: [Robot] {
            Barred { barred: usize, reachable: usize } => "{barred} of {reachable} poses that can be reached are excluded: their length might leave the stroke";
            FirstStage { barred: usize, reachable: usize } => "this is the first stage: {barred} of {reachable} poses that can be reached are still excluded, because their length might leave the stroke", help: "measure these poses, identify, and plan again with robot-identified.toml";
            FurtherStage { lengths: usize, barred: usize, reachable: usize } => "this is a further stage, after {lengths} lengths: {barred} of {reachable} poses that can be reached are still excluded, because their length might leave the stroke", help: "measure these poses, identify, and plan again with robot-identified.toml";
        }
        I0713 "changes that would make a refused plan possible",
        cause: "The planner tried other orientations of the tool on a coarse grid, at the points of the circle only.",
        cure: "Write the values into the job and plan again.",
        asks: [Robot, Stage] {
            OrientationPasses { circle: u32, tilt_deg: f64, spin_deg: f64 } => "circle {circle}: tilt_deg = {tilt_deg}, spin_deg = {spin_deg} keep the axis limits, the wrist and the configuration at its points";
            NoOrientationPasses { circle: u32 } => "circle {circle}: no tilt_deg and spin_deg of a coarse grid would pass: make amplitude_deg smaller, or move the base ball";
            TeachFirst { ball: u32, axes_deg: String } => "base ball {ball} was measured, and how it was taught is not known: with that knowledge more poses are safe", help: "write taught_deg into its [[centre]] as it was taught before the first stage, or bring the tool ball onto it near A1..A6 = {axes_deg} and write the angles there";
            FewInReach { reachable: usize, wanted: u32 } => "{reachable} of {wanted} poses wanted are within axis limits, singularities, cups and obstacles", help: "move the base ball or what is in its way, use a shorter bar, make `points` smaller, or `candidates` greater";
            StrokeNeeded { ball: u32, half_mm: f64, low_mm: f64, high_mm: f64 } => "base ball {ball}: a first stage needs a stroke of about +-{half_mm:.2} mm as the robot is known now; this bar has {low_mm} to {high_mm} mm", help: "use a bar with that stroke, or a shorter bar; write a smaller [tolerance] into the robot file if the maker promises it";
            StageFirst { points: u32 } => "the robot is not known well enough for these circles and this stroke: a stage of {points} poses has only lengths that are safe as it is known now", help: "measure them, identify, and plan again with robot-identified.toml";
        }
        I0714 "how many lengths are enough",
        cause: "The remaining error over the workspace is predicted for parts of the plan (the most informative lengths first) and for the plan measured twice.",
        cure: "Measure fewer lengths where fewer are enough. Where more do not help, choose other poses, another base ball or a better known bar." {
            Enough { lengths: usize, error_mm: f64, repeatability_mm: f64, planned: usize, planned_error_mm: f64, doubled: usize, doubled_error_mm: f64 } => "{lengths} lengths are enough: the remaining 3-D error is {error_mm:.3} mm, less than the robot's repeatability of {repeatability_mm} mm; {planned} leave {planned_error_mm:.3} mm, {doubled} leave {doubled_error_mm:.3} mm";
            OthersNeeded { planned: usize, planned_error_mm: f64, doubled_error_mm: f64 } => "{planned} lengths leave {planned_error_mm:.3} mm, twice as many {doubled_error_mm:.3} mm: only other poses, another base ball or a better known bar (length_u_mm) would help";
            MoreHelp { planned: usize, planned_error_mm: f64, doubled_error_mm: f64 } => "{planned} lengths leave {planned_error_mm:.3} mm; twice as many would leave {doubled_error_mm:.3} mm";
        }
        I0715 "how far from the base balls a result is valid",
        cause: "The predicted uncertainty grows with the distance from the base balls.",
        cure: "Put a base ball where the robot works, or give `workspace_mm`." {
            ValidNear { within_mm: f64, least_mm: f64, most_mm: f64, farther_mm: f64 } => "the result is valid up to {within_mm} mm from the base balls, where {least_mm:.3} to {most_mm:.3} mm are left; farther out up to {farther_mm:.3} mm";
            ValidEverywhere { least_mm: f64, most_mm: f64 } => "the result is valid over the whole workspace, with {least_mm:.3} to {most_mm:.3} mm left";
        }
        I0716 "whether a second base ball would help",
        cause: "The best poses were chosen again about this ball and with a second one at several places.",
        cure: "Where a place helps, put a second ball near it and add its [[centre]] table." {
            SecondBall { place: &'static str, x_mm: f64, y_mm: f64, z_mm: f64, percent: f64, turned_percent: f64 } => "a second base ball {place}, near ({x_mm:.0}, {y_mm:.0}, {z_mm:.0}) mm, would leave {percent:.0} % of the 3-D error of as many poses chosen freely about this one; one turned about axis 1 alone leaves {turned_percent:.0} % of the error";
            NoSecondBall { places: usize, percent: f64, turned_percent: f64 } => "no second base ball of {places} places tried would leave less than {percent:.0} % of the 3-D error of as many poses chosen freely about this one; one turned about axis 1 alone leaves {turned_percent:.0} % of the error";
        }
        I0717 "teach a base ball again",
        cause: "No pose is safe enough from where `taught_deg` says that the ball was taught; from another place there is one.",
        cure: "Put the ball where the tool ball is at the axis angles that the plan prints, and write these into `taught_deg`." {
            TeachAgain { ball: u32 } => "base ball {ball}: no run is safe from where it was taught: the plan gives a new place to teach it";
        }
        E0750 "a goal is not reached",
        cause: "The position error that 90 % of the robots would keep after the best run of the search is greater than the goal, it takes longer than `minutes`, or no ball at a [[place]] is in reach.",
        cure: "State more places and bars, a better certificate, more minutes, or a greater goal. I0751 says what limits it." {
            GoalNotReached { goal_mm: f64, of: &'static str, best_mm: f64, minutes: f64, poses: usize, balls: usize, bar_mm: f64 } => "the goal of {goal_mm} mm ({of}) is not reached: the best run, {poses} poses about {balls} ball(s) with a bar of {bar_mm} mm in {minutes:.0} min, leaves {best_mm:.3} mm";
            NoPoseOfRegion => "no pose with the tool in `region_mm` is within the limits of the axes", help: "region_mm is in the robot base, mm, and the tool points down within 45 degrees";
            NoPlaceForBall => "at no [[centre]] and [[place]] has a ball enough poses within the limits";
            NoTimeForPoses => "`minutes` do not suffice to mount a bar and a ball and to measure 12 poses";
        }
        I0751 "what limits a goal",
        cause: "The best run was judged again without each source of its uncertainty.",
        cure: "Improve the first one that is named; or give the run more time." {
            GoalTakesLonger { minutes: f64, poses: usize, balls: usize, bar_mm: f64 } => "{poses} poses about {balls} ball(s) with a bar of {bar_mm} mm reach it in {minutes:.0} min";
            GoalLimited { source: &'static str, left_mm: f64 } => "without {source} the best run leaves {left_mm:.3} mm";
            GoalLimitedByPlaces => "no single source limits it: a longer bar, or balls at other places and heights would help";
        }
        W0720 "the covariance of the identification is not known",
        cause: "The robot file was identified, but the lengths.csv that `identify` wrote beside it is not there.",
        cure: "Keep the two files together, or give the lengths that were measured. Until then the risk is that of the maker's tolerance about the identified robot.",
        asks: [MeasuredLengths] {
            NoLengths { file: String } => "{file} is not there: the stroke risk is that of the maker's tolerance about the identified robot";
        }
        E0721 "earlier lengths do not determine a robot",
        cause: "They belong to other base balls, or they are of another robot or another bar.",
        cure: "Give only lengths that were measured to the base balls of this job." {
            NoFiniteRobot => "the lengths measured before give no finite robot";
            OtherBar { off_mm: f64, sd_mm: f64, low_mm: f64, high_mm: f64 } => "the lengths measured before are those of a bar whose length is {off_mm:+.2} mm (u {sd_mm:.2}) off the job's, whose stroke is {low_mm} to {high_mm} mm", help: "is length_mm of the job that of this bar, and were the lengths computed with it?";
        }
        E0730 "plan.csv and plan.json do not belong together",
        cause: "One of them was edited, copied from elsewhere, or is of another version.",
        cure: "Plan again: `dbbd plan` writes both. Change the job, never the plan." {
            NoHeader { json: String } => "has no {json} beside it: it is not a plan, or half of one", help: "name the plan.csv that `dbbd plan` wrote, with its plan.json in the same directory";
            OtherHash { other: String, hash: String, found: String } => "is not what was written together with {other}, or one of the two was changed since: hash {hash}, not {found}", help: "plan again: `dbbd plan` writes both";
            Moves { rows: usize, moves: usize } => "`moves` has {moves} entries: it must have one for each of {rows} rows, in order";
            PassCount { passes: usize, found: usize } => "`passes` has {passes} entries, the rows have {found} passes";
            PassRows { entry: usize } => "`passes`: entry {entry} names other rows than those of that pass";
            PassNumbers { entry: usize } => "`passes`: entry {entry} has a number that cannot be";
            NoSuchBall { ball: u32, balls: usize } => "centre = {ball}: the job has {balls} base balls";
        }
        E0731 "a file is not a plan",
        cause: "It is another file, it was edited, or it is of another version.",
        cure: "Plan again: `dbbd plan` writes plan.csv and plan.json. Change the job, never the plan." {
            NotHeader { why: String } => "{why}";
            Schema { schema: u32, known: u32 } => "has schema {schema}: this version reads schema {known}";
            NoRows => "has no rows: it is not a plan";
            OtherColumns { columns: String } => "the columns are not those of a plan: {columns}", help: "plan again: was the file saved by another program, such as a spreadsheet?";
            RowIndex { index: u32, expected: usize } => "index = {index} must be {expected}: rows count from 1";
            NotFinite { value: f64 } => "{value} is not a finite number";
            StatusTurn { status: u8, turn: u8 } => "status = {status}, turn = {turn}: at most 7 and 63";
            Dwell { dwell_s: f64, kind: String } => "dwell_s = {dwell_s} in a {kind} row";
            ArcRows => "an arc is two `circ` rows: its auxiliary point in transit, then its end";
            PassPattern => "a pass without stops is two auxiliary `circ` rows in transit, the points (dwell_s = 0), and its end in transit";
        }
        E0740 "a check is planned without a calibration",
        cause: "`criterion = \"change\"` chooses poses that detect changes of a calibrated robot.",
        cure: "Plan an interim check, with robot-identified.toml.",
        asks: [InterimCheck, Robot] {
            NotCalibrated => "the criterion `change` needs a calibrated robot", help: "plan an interim check, with robot-identified.toml";
        }
    }
}

impl PlanFinding {
    /// Whether fewer poses can be chosen than are wanted.
    pub(super) fn is_too_few_poses(&self) -> bool {
        matches!(
            self,
            Self::TooFewPoses { .. } | Self::NoPose { .. } | Self::NoSafeStart { .. } | Self::NoPath
        )
    }
}
