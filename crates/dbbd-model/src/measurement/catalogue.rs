//! Tables of measurements and of base balls.

use crate::findings;

findings! {
    /// A table of measurements or of base balls that does not fit.
    MeasurementFinding "Tables of measurements" {
        E1201 "a table holds no row",
        cause: "The file has only a header, or nothing.",
        cure: "Check that the program that wrote the file has finished, and that it is the right file." {
            NoMeasurement => "holds no measurement: only a header, or nothing";
            NoPose => "holds no pose: only a header, or nothing";
        }
        E1202 "the numbers of balls, bars or targets have a gap or go too far",
        cause: "Balls, bars and targets are numbered 1, 2, .. without a gap, and no number of a ball occurs twice. One calibration has at most 100 balls, 20 bars and 20 targets.",
        cure: "Number them again, in all files alike." {
            BallsNotInOrder { ball: u32, found: u32 } => "the numbers in column `centre` must run 1, 2, .., each once: {found} is there where {ball} is expected";
            NoBall => "holds no base ball: only a header, or nothing";
            BarWithoutLength { bar: u32 } => "column `bar`: the numbers must run 1, 2, ..: bar {bar} has no length";
            TooManyTargets { targets: usize, most: usize } => "the highest number in column `target` is {targets}: one calibration has at most {most} targets";
            UnseenTarget { target: u32 } => "column `target`: the numbers must run 1, 2, ..: target {target} has no measurement";
            TooMany { balls: usize, bars: usize, most_balls: usize, most_bars: usize } => "the highest numbers are ball {balls} and bar {bars}: one calibration has at most {most_balls} balls and {most_bars} bars";
        }
        E1203 "a measurement is of a ball, bar or target that is not there",
        cause: "The column `centre`, `bar` or `target` holds a number for which nothing is given.",
        cure: "Give all base balls (in a table, or the job's [[centre]]); measurements that only check must be of the bars and targets that were identified.",
        asks: [BaseBalls] {
            UnknownBall { index: u32, ball: u32, balls: usize } => "index {index}: base ball {ball} is not among the {balls} that are given";
            UnknownTarget { index: u32, target: u32, targets: usize } => "index {index}: target {target} is not among the {targets} of the input";
            UntrackedPosition { index: u32 } => "index {index}: a position, but the robot is identified from lengths alone";
            UnknownBar { index: u32, bar: u32, bars: usize } => "index {index}: bar {bar} is not among the {bars} of the input";
        }
        E1204 "a table is not of measurements",
        cause: "The file is a plan, whose lengths are the wanted ones, or its lengths or angles are in another unit than its header says.",
        cure: "Measure the plan with `dbbd acquire` and give the capture; convert the table to mm and degrees." {
            IsPlan => "is a plan: its lengths are the wanted ones, not measured ones", help: "measure them: `dbbd acquire`, then give the capture";
            OtherUnit { columns: String, unit: String, rows: usize, index: u32 } => "{columns} of {rows} rows, from index {index} on, seem to be {unit}: in these the measurements agree with the poses", help: "convert the table: lengths in mm, angles in degrees";
        }
        E1208 "different rows of a table have the same index",
        cause: "Tables of several runs were joined, or rows were edited: it is not certain which length belongs to which pose.",
        cure: "Number the rows again, each with an index of its own." {
            EqualIndices { index: u32 } => "index {index} is there more than once, with different rows";
        }
        W1209 "a table has duplicate rows",
        cause: "A file was read or pasted twice. Counted twice, its lengths would state an accuracy that they do not have.",
        cure: "Nothing: each is used once. Remove the copies from the table." {
            Repeated { repeated: usize, rows: usize } => "{repeated} of {rows} rows repeat other rows and are used once";
        }
        W1280 "standard deviations of some lengths are missing or of another magnitude",
        cause: "The column sigma_mm is empty in some rows: unless every row has a value, none is used and all lengths have equal weight. Or a value was mistyped or is in another unit.",
        cure: "Correct the column, or leave it out and give one standard deviation for all.",
        asks: [Sigma] {
            OtherSigma { index: u32, sigma_mm: f64, usual_mm: f64 } => "index {index} has sigma_mm = {sigma_mm}; the usual value is {usual_mm}";
            SigmaMissing { without: usize, rows: usize } => "{without} of {rows} rows have no sigma_mm: none is used, and all lengths have equal weight";
        }
        I1284 "the numbers of a table are rounded",
        cause: "Lengths have one decimal, or angles at most two: they were read from a pendant, or rounded. Axis angles with two decimals are known to 0.003 degrees only, which is 0.1 mm at a distance of two metres.",
        cure: "Nothing, if these are the commanded angles. Else take the angles that the program logged (to `dbbd sync`, or from the controller).",
        asks: [LoggedAxes] {
            OneDecimal { rows: usize } => "the lengths of {rows} rows have one decimal: they are uncertain by 0.03 mm";
            FewDecimals { rows: usize, decimals: i32, length_mm: f64 } => "the decimals of the axis angles of {rows} rows are {decimals}: if they are rounded, a length is uncertain by some {length_mm:.2} mm";
        }
        W1283 "all lengths of a table are equal",
        cause: "The lengths are the commanded ones, the bar was frozen, or the column was filled with one value. No two measured lengths are equal to the last digit so often.",
        cure: "Give the lengths that the bar measured." {
            AllEqual { rows: usize, length_mm: f64 } => "all {rows} lengths are {length_mm} mm: were they measured?";
            FrozenRows { rows: usize, index: u32, length_mm: f64 } => "{rows} rows one after the other, from index {index} on, have the length {length_mm} mm: was the bar frozen?";
        }
        W1282 "the lengths of single rows are impossible",
        cause: "The number of the ball, an angle or the length of a row was mistyped or is in another unit. One such row can spoil the whole result.",
        cure: "Correct or remove the row that is named." {
            FarFromAll { off_mm: f64 } => "the lengths differ by {off_mm:.0} mm from those that robot and base balls predict: are the numbers of base balls exchanged, or is it another robot or tool?";
            FarLengths { rows: usize, index: u32, off_mm: f64 } => "{rows} rows, first index {index}, differ by {off_mm:.0} mm from the lengths that robot and base balls predict";
        }
        W1281 "axis angles are beyond the robot's limits, or in radians",
        cause: "The table is of another robot, an angle was mistyped or is in another unit, or limits_deg of the robot file are those of another arm.",
        cure: "Correct the row that is named, the robot, or limits_deg in the robot file.",
        asks: [Robot] {
            Radians { rows: usize } => "all axis angles of {rows} rows are within 2 pi: are they in radians?";
            RowsInRadians { rows: usize, index: usize } => "all axis angles of {rows} rows are within 2 pi, first row {index}: are they in radians?";
            BeyondLimits { rows: usize, index: usize, axis: usize, deg: f64 } => "{rows} rows are beyond the limits of the robot, first index {index}: axis {axis} at {deg} degrees";
        }
        E1205 "a sense of approach is not valid",
        cause: "A cell of the columns `approach1` to `approach6` is not -1, 0 or 1.",
        cure: "Write 1 where the axis came to the pose by rising angles, -1 by falling ones, and 0 or nothing where it is not known." {
            NotASense { column: String, cell: String } => "column `{column}`: `{cell}` is not -1, 0 or 1";
        }
    }
}
