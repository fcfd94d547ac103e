//! Estimation: what is refused, and what has a warning or is worth knowing of a result.

use crate::diagnostic::Names;
use crate::findings;

findings! {
    /// What an estimation refuses, warns of or notes.
    EstimationFinding "Estimation" {
        E1301 "these lengths cannot be used",
        cause: "A number is impossible (an angle, a length, a sigma, the tool ball or a base ball), options contradict each other, or none of the parameters asked for changes a length in these poses.",
        cure: "Check angles, lengths, standard deviations, tool ball and base balls. Ask for other parameters, or vary the poses. A list is fitted without a prior and can run away: with the prior of the data sheet it does not.",
        asks: [ToolBall, BaseBalls, Estimated, Folds, Prior] {
            NotFinite => "a length or its derivative is not finite";
            NoFolds { folds: usize, lengths: usize } => "{folds} folds: {lengths} lengths are cut into 2 folds or more, at most one for each length";
            SmallWorkspace { poses: usize, least: usize } => "{poses} poses are too few for a workspace: at least {least} are needed";
            NothingToEstimate => "none of the parameters asked for changes a length in these poses";
        }
        E1302 "an input of the estimation is missing",
        cause: "A capture carries the robot and the base balls of its plan; a table of lengths carries neither. A run whose lengths match no pose contains no measurement.",
        cure: "Give the robot and the base balls with a table. For a run, `dbbd sync` reports for each pose why it has no length.",
        asks: [Robot, BaseBalls] {
            NoRobot => "a table of lengths needs a robot", help: "name a built-in robot, the file of a robot, or the directory of a result";
            NoBalls => "a table of lengths needs the base balls";
            NoLength => "no length matches a pose";
        }
        E1304 "a prior cannot be used",
        cause: "A row of the table `name,unit,sd` names a parameter twice, has another unit, or its sd is in another unit (degrees, micrometres); or the robot file has no covariance of its earlier identification.",
        cure: "Correct the row; give the robot-identified.toml. The parameters.csv of an earlier identification of the same robot is such a table.",
        asks: [Prior] {
            EmptyPrior => "the prior has no row with a standard deviation";
            OtherUnitThan { parameter: String, unit: String, given: String } => "`{parameter}` is in {unit}, not in `{given}`";
            ParameterTwice { parameter: String } => "`{parameter}` occurs twice";
            NoPosterior => "the robot file has no [posterior] of its values", help: "robot-identified.toml has it; or use the prior of the data sheet";
        }
        E1305 "an argument of the estimation cannot be read",
        cause: "The text is not what is needed there.",
        cure: "Write what the message asks for; the help of `dbbd identify` has an example of each.",
        asks: [ToolBall] {
            NotAPoint => "three numbers in mm are needed, as 30,20,10";
        }
        E1306 "parts of a measurement cannot be joined",
        cause: "A capture or a table is given twice, also under another name, as a copy or in part, or a part has positions of a tracker.",
        cure: "Give each capture and table once, and positions by their own option.",
        asks: [Positions] {
            PartTwice { other: String } => "it has lengths of {other}: they would count twice";
            PartOfPositions => "positions of a tracker are not a part of a measurement with a bar";
        }
        I1342 "how the parts of a measurement belong together",
        cause: "Several captures or tables are evaluated together.",
        cure: "Nothing to do, if the message is right; else say whether the set-up is the same.",
        asks: [SetUpRelation] {
            PartOfSameSetUp => "goes on in the set-up of the part before: base balls and zero of the bar are shared, and tested for a change";
            PartOfNewSetUp { first_ball: usize, bar: u32 } => "is a set-up of its own: its base balls are numbered from {first_ball}, its bar is {bar}";
            Superseded { count: usize, rows: String } => "{count} lengths were measured again on request and are not used: rows {rows}";
        }
        E1307 "a row that shall be left out does not exist",
        cause: "No length or position of the inputs has this index.",
        cure: "Name rows by the column index of lengths.csv, of the run or of the table.",
        asks: [Exclude] {
            NoRowToExclude { index: u32 } => "no length has the index {index}: none can be left out";
        }
        I1343 "lengths are left out on request",
        cause: "The request names them.",
        cure: "Nothing, if the reason holds. `excluded` in result.json lists them with who and why." {
            Excluded { count: usize, rows: String } => "{count} lengths are left out of the fit on request: rows {rows}";
        }
        W1310 "the solver did not converge",
        cause: "The start is too far from the truth: a base ball or the tool ball is elsewhere than given, or lengths and poses do not belong together.",
        cure: "Check the places of the base balls and the tool ball.",
        asks: [BaseBalls, ToolBall] {
            NotConverged { iterations: usize } => "the solver did not converge in {iterations} steps";
        }
        W1311 "the lengths fit worse than the nominal robot could",
        cause: "Lengths and poses do not belong together, or a base ball, the tool ball or the robot is another one: the ball was taught with another tool, or another plan was driven.",
        cure: "Check the plan, base balls, tool ball and robot.",
        asks: [BaseBalls, ToolBall, Robot] {
            FitsWorseThanNominal { residual_rms_mm: f64, predicted_max_mm: f64 } => "the lengths fit only to {residual_rms_mm:.2} mm, although the nominal robot is predicted to be off by at most {predicted_max_mm:.2} mm";
        }
        W1312 "a correction or a position is not plausible",
        cause: "A fixed part of the set-up is not where it was given, or it is another robot. A ball or bar that comes out far from where it was given is poorly observable in these poses, or was given wrongly.",
        cure: "Let the fixed part be estimated, or measure it again; check the robot. Turn the tool more, or fix a value that you trust.",
        asks: [Robot, Fixed] {
            ImplausibleWithFixed { fixed: Names, parameters: Names, times: f64 } => "with {fixed} fixed, the corrections of {parameters} are more than {times:.0} times the robot's tolerance";
            PlaceContradicted { fixed: Names, held_mm: f64, free_mm: f64 } => "with {fixed} fixed the lengths fit to {held_mm:.3} mm, and to {free_mm:.3} mm if these are estimated: they are not where they were given";
            BarContradicted { off_mm: f64, sd_mm: f64 } => "within the tolerance of the robot, the lengths belong to a bar whose length is {off_mm:+.3} mm (u {sd_mm:.3}) off what is stated: is its length right?";
            Implausible { parameters: Names, times: f64 } => "the corrections of {parameters} are more than {times:.0} times the robot's tolerance: no robot is so far off";
            Displaced { parameters: Names } => "{parameters} came out far from where they were given";
        }
        W1313 "more than one length in ten is an outlier",
        cause: "Lengths are matched to wrong poses, or the bar slipped: then the lengths that are left cannot be relied on either.",
        cure: "Check the pose matching with `dbbd sync`; measure again." {
            ManyOutliers { outliers: usize, lengths: usize } => "{outliers} of {lengths} lengths are outliers";
        }
        I1314 "lengths are not used",
        cause: "Their residuals are too large for the noise of the others.",
        cure: "Nothing, if they are few. `outliers` in result.json names them." {
            Outliers { outliers: usize } => "{outliers} lengths are outliers and are not used";
        }
        W1315 "no length is left over to check the result",
        cause: "There are as many parameters as lengths.",
        cure: "Measure more poses, or estimate fewer parameters." {
            NoFreedom { lengths: usize, parameters: f64 } => "{lengths} lengths for {parameters:.0} parameters leave no residual to check the result";
        }
        W1316 "the residuals are larger than the sigma given",
        cause: "The model lacks something (repeatability, reversal error, transmission error, sag, warming up, a ball that moved), or sigma is too small.",
        cure: "Give the standard deviation of a length with the robot's repeatability in it, or measure more poses. report.html shows the residuals against each axis.",
        asks: [Sigma] {
            BeyondSigma { times: f64 } => "the residuals are {times:.1} times the sigma given, from which the standard deviations are computed";
            BeyondSigmaOfFew { times: f64 } => "the residuals are {times:.1} times the sigma of the lengths; so few lengths cannot estimate another, so the standard deviations are computed from that sigma";
        }
        I1317 "the residuals do not agree with the sigma in the data",
        cause: "Larger: what the model lacks, or a worse repeatability than that of the robot file, comes on top of the bar's noise and that repeatability. Smaller: sigma is too large, or lengths repeat each other.",
        cure: "Nothing: larger residuals are counted in the standard deviations. Correct sigma_mm if the standard deviations shall be as small as the residuals." {
            AboveSigma { times: f64 } => "the residuals are {times:.1} times the sigma of the lengths and the repeatability of the robot together; the standard deviations are computed from the residuals";
            BelowSigma { times: f64 } => "the residuals are only {times:.2} times the sigma of the lengths";
        }
        W1319 "the lengths fit, but the position is not determined",
        cause: "A small residual proves nothing: the predicted position uncertainty over the workspace is hardly smaller than that of the nominal robot, or larger.",
        cure: "Measure what the line `next:` recommends: a further ball or other circles.",
        asks: [Prior] {
            PositionUndetermined { residual_rms_mm: f64, identified_mm: f64, nominal_mm: f64 } => "the lengths fit to {residual_rms_mm:.3} mm, but the predicted position uncertainty is {identified_mm:.2} mm, the nominal robot's {nominal_mm:.2} mm";
        }
        I1320 "the parameters listed improve the position only a little",
        cause: "Few parameters are to be estimated; the others keep their nominal values.",
        cure: "Leave the list out, or measure what the line `next:` recommends.",
        asks: [Estimated] {
            ListImprovesLittle { residual_rms_mm: f64, identified_mm: f64, nominal_mm: f64 } => "the lengths fit to {residual_rms_mm:.3} mm, and the predicted position uncertainty is {identified_mm:.2} mm, the nominal robot's {nominal_mm:.2} mm";
        }
        I1321 "coordinates of the set-up are poorly observable",
        cause: "These poses leave a coordinate of the tool ball open by more than 50 mm, or that of a base ball by more than 500 mm, as where the tool never turns or every bar lies in one plane. It keeps its start value.",
        cure: "Turn the tool in the poses, and tilt the bar out of one plane." {
            PoorlyObservable { parameters: Names } => "fixed because these poses leave them open: {parameters}";
        }
        W1322 "the corrections are far larger than the prior allows",
        cause: "The robot is worse than the tolerance in its file (a crash, another arm, a lost mastering), or lengths and poses do not belong together.",
        cure: "Check [tolerance] in the robot file, the residuals and the held-out residuals; give a prior with wider standard deviations.",
        asks: [Prior] {
            FarBeyondPrior { times: f64 } => "the corrections are {times:.1} times as large as the prior allows";
        }
        I1323 "the corrections are larger than the prior allows",
        cause: "The robot is worse than the tolerance in its file.",
        cure: "Correct [tolerance] in the robot file, or give a prior with wider standard deviations.",
        asks: [Prior] {
            BeyondPrior { times: f64 } => "the corrections are {times:.1} times as large as the prior allows";
        }
        W1324 "Monte Carlo fits did not converge",
        cause: "The noise is so large that the lengths are far from linear in the parameters.",
        cure: "Check the standard deviation of a length; measure more poses.",
        asks: [Sigma] {
            TrialsNotConverged { failed: usize, trials: usize } => "{failed} of {trials} Monte Carlo fits did not converge and do not count";
        }
        I1325 "Monte Carlo and linear intervals disagree",
        cause: "The lengths are not linear in these parameters over the width of the intervals.",
        cure: "Use the Monte Carlo intervals." {
            IntervalsDisagree { parameters: Names } => "Monte Carlo and linear 95 % intervals disagree for {parameters}";
        }
        I1326 "the identified robot has joint errors",
        cause: "The lengths show compliance, harmonics, smooth errors, backlash or ripple of the joints, so robot-identified.toml contains them. URDF, mastering offsets and programs that read only lengths and angles cannot represent them.",
        cure: "Use `dbbd predict` and `dbbd compensate`, or the table joint-errors.csv. The geometric model identifies the best robot without joint errors.",
        asks: [Model] {
            BeyondTable { left_out_mm: f64 } => "robot-identified.toml contains joint errors: a program that reads only lengths and angles leaves out {left_out_mm:.3} mm on average over the workspace";
        }
        I1341 "a bar without a certificate is fixed",
        cause: "The offset is fixed of a bar whose uncertainty neither the job (length_u_mm) nor anything else states. Its length then counts as exact, in the standard deviations and in the predicted uncertainty too.",
        cure: "State the uncertainty of its length, or let the offset be estimated.",
        asks: [Fixed, BarUncertainty] {
            UncertifiedHeld => "the bar has no certificate, and its offset is fixed: its length counts as exact";
        }
        I1340 "the tolerance in the robot file is too small for this robot",
        cause: "The corrections are larger than [tolerance] allows. No prior was named, so the standard deviations of the prior were widened to match the lengths.",
        cure: "Correct [tolerance] in the robot file." {
            PriorWidened { times: f64 } => "the corrections are {times:.1} times as large as the tolerance in the robot file allows; the prior was widened by this factor";
        }
        W1327 "the controller seems to use its own calibrated model",
        cause: "The lengths agree with the nominal robot better than its tolerance lets any robot do: in absolute-accuracy mode, or in the run of a corrected program, the axes are not at the angles that are given; or the lengths are the commanded ones.",
        cure: "Give the axis angles that the program logged to `dbbd sync`, then identify its observations. Give lengths that the bar measured.",
        asks: [LoggedAxes] {
            AbsoluteAccuracyMode { residual_rms_mm: f64, expected_mm: f64 } => "the lengths agree with the nominal robot to {residual_rms_mm:.3} mm; its tolerance predicts {expected_mm:.2} mm";
        }
        W1328 "the run has warnings",
        cause: "A part of the run is damaged, the bar was mounted badly (W0280 to W0284), or its poses were planned for another robot.",
        cure: "`dbbd info` names the damages. Give the robot of the plan, or plan for this one.",
        asks: [Robot] {
            PartOfRunLost => "a part of the run was lost or is not as it should be";
            PlannedForAnother { planned: String, given: String } => "the poses are of a plan for {planned}, and the robot given is {given}";
        }
        W1330 "the lengths seem to belong to other rows",
        cause: "With the column of the lengths moved by some rows they fit decisively better: a row was lost or inserted in the table or in the trace.",
        cure: "Compare the first and the last rows of poses and lengths; give the lengths to their own poses. `gain` is the natural logarithm of the likelihood ratio." {
            ShiftedRows { rows: isize, residual_mm: f64, shifted_mm: f64, gain: f64 } => "with each length moved by {rows} row(s) the residual falls from {residual_mm:.4} mm to {shifted_mm:.4} mm (likelihood ratio e^{gain:.0})";
        }
        W1331 "a ball moved, or has another number, within the data",
        cause: "From one row on the lengths belong to another place of a ball: it was mounted again, hit, or moved in its seat; or rows have the number of another ball. The table is as it was: what happened is an unknown of the result, with its own standard deviation.",
        cure: "Check the seats of the balls and the column `centre`. Measure again where it matters.",
        asks: [BaseBalls] {
            BaseBallMoved { ball: u32, index: u32, size_mm: f64, sd_mm: f64 } => "from index {index} on ball {ball} is {size_mm:.4} mm (standard uncertainty {sd_mm:.4} mm) from where it was";
            ToolBallMoved { index: u32, size_mm: f64, sd_mm: f64 } => "from index {index} on the tool ball is {size_mm:.4} mm (standard uncertainty {sd_mm:.4} mm) from where it was on the flange",
                help: "the result is as if it had not moved, with this place as a further unknown: fasten the tool ball, and measure again if its own place matters";
            WrongBall { ball: u32, indices: Names } => "the rows {indices} fit ball {ball}: they were used as lengths to it";
        }
        W1332 "the covariance of an earlier identification is lost",
        cause: "The robot was identified before, but its file has no covariance of the result: an older version wrote it, or its values were changed since. Only the new lengths are then used, so the predicted position uncertainty can increase.",
        cure: "Give the robot-identified.toml as it was written; or identify the earlier lengths together with these. Without a prior it starts again without this warning.",
        asks: [Prior] {
            PosteriorLost => "the robot was identified before, but its file has no [posterior]: what these lengths do not determine is fixed as if it were exact or known by the tolerance alone";
            PosteriorOfOtherValues => "[posterior] is of other values than the robot's: they were changed since, and it is not used";
        }
        W1333 "a zero changed within the data",
        cause: "The zero of a bar or of an axis, or the frame of the tracker, stepped at one row or drifted over the rows: the bar was reset, hit or warmed up, its counter lost a count, the arm was hit or mastered, the tracker moved, or a column of the table was sorted. The table is as it was: what happened is an unknown of the result, with its own standard deviation.",
        cure: "Check the zero of the bar before and after a run, and let bar and robot become warm first. The lengths do not show which zero of a bar is right: measure again where it matters. Where an axis stepped, the result is the robot before: measure the robot again as it is now." {
            ZeroStep { bar: u32, index: u32, by_mm: f64, sd_mm: f64 } => "from index {index} on the lengths of bar {bar} differ by {by_mm:+.4} mm (standard uncertainty {sd_mm:.4} mm) from those before";
            ZeroDrift { bar: u32, by_mm: f64, sd_mm: f64 } => "the lengths of bar {bar} drift by {by_mm:.4} mm (standard uncertainty {sd_mm:.4} mm) from the first row to the last";
            AxisZeroStep { axis: usize, index: u32, by_deg: f64, sd_deg: f64 } => "from index {index} on axis {axis} is {by_deg:+.4}° (standard uncertainty {sd_deg:.4}°) from where it was";
            TrackerStep { index: u32, size_mm: f64, sd_mm: f64 } => "from index {index} on the tracker's frame is {size_mm:.4} mm (standard uncertainty {sd_mm:.4} mm) from where it was";
            TrackerDrift { size_mm: f64, sd_mm: f64 } => "the tracker's frame drifts by {size_mm:.4} mm (standard uncertainty {sd_mm:.4} mm) from the first row to the last";
        }
        I1336 "something may have happened within the data",
        cause: "The lengths speak for it, but not beyond what else explains the same. The result is as if it had not happened.",
        cure: "Check the bar, the balls and the table at that row; `hypotheses` in result.json has the probability and the rivals." {
            CouldBe { event: &'static str, size: f64, unit: &'static str, probability: f64, rivals: String } => "could be {event}, {size:.4} {unit} (probability {probability:.2}){rivals}";
            CouldBeFrom { event: &'static str, index: u32, size: f64, unit: &'static str, probability: f64, rivals: String } => "could be {event} from index {index} on, {size:.4} {unit} (probability {probability:.2}){rivals}";
        }
        W1334 "lengths that identified the robot are used again",
        cause: "More of these lengths than by chance are in the lengths.csv beside the robot's file or the table of the prior, which holds them already. Counted twice, they would state an accuracy that they do not have.",
        cure: "Nothing: the prior of the data sheet was used. To identify again, give the nominal robot; to go on, give only new lengths." {
            KnownLengths { known: usize, lengths: usize } => "{known} of {lengths} lengths identified this robot already: what they showed is not used as a prior";
        }
        W1335 "the sigma given is far larger than the residuals",
        cause: "The standard deviation given or the column sigma_mm is in micrometres, or it is not that of these lengths. Lengths that seem so poor leave most of the robot at its nominal values.",
        cure: "Give sigma in mm, or leave it out.",
        asks: [Sigma] {
            FarBelowSigma { sigma_mm: f64, times: f64 } => "sigma is {sigma_mm:.3} mm, and the residuals are only {times:.2} times as large: is it in micrometres?";
        }
        W1381 "the residuals are far larger than the repeatability of the robot",
        cause: "The lengths do not belong to their poses (a column sorted or shifted, bars of two lengths under one number, another unit), or the model lacks most of the error (transmission error, backlash, sag, a list of parameters that is too short).",
        cure: "Look at the residuals in report.html: by row they show a mistake in the table, by axis an error of a joint. Check `bar`, `centre`, the robot and the list of parameters.",
        asks: [Robot, Estimated] {
            BeyondRepeatability { residual_rms_mm: f64, repeatability_mm: f64 } => "the lengths fit to {residual_rms_mm:.3} mm; the repeatability of the robot along a length is {repeatability_mm:.3} mm";
        }
        W1382 "validation lengths do not fit",
        cause: "They are of another robot, another mounting of the ball, another bar or other poses than the lengths that identified the robot.",
        cure: "Check where the lengths for validation come from.",
        asks: [Validation] {
            HeldOutDiffers { held_out_mm: f64, residual_rms_mm: f64 } => "the validation lengths fit to {held_out_mm:.3} mm, and those that were used to {residual_rms_mm:.3} mm";
        }
        I1380 "no further measurement could be evaluated",
        cause: "The predicted covariance of further measurements is not finite, for example because standard deviations of the lengths differ too much.",
        cure: "Check sigma_mm of the lengths, the standard deviation given and [tolerance] of the robot file.",
        asks: [Sigma] {
            NoRecommendation => "the predicted gain of further measurements is not finite: none is recommended";
        }
        I1337 "the sense of approach is not known",
        cause: "No row says in which sense its axes came to the pose, so backlash is noise of every pose: it costs accuracy, in the estimate and in every prediction.",
        cure: "Give the columns approach1..approach6 (-1, 0 or 1: the sense of each axis's last move before the pose). `dbbd sync` writes them for a run of a plan." {
            ApproachUnknown { backlash_mm: f64, identified_mm: f64 } => "no row has approach1..approach6: backlash that nobody can correct moves the tool ball by {backlash_mm:.3} mm on average, of {identified_mm:.3} mm predicted";
        }
        E1360 "positions do not agree with the poses of the robot",
        cause: "The rows are of another robot, positions and axis angles were joined in another order, columns were swapped, or the frame is left-handed.",
        cure: "Compare one row with the robot: its pose and its position. Give the coordinates in a right-handed frame." {
            PositionsElsewhere { misfit_percent: f64 } => "no location of the tracker makes the positions agree with the tool of the robot: {misfit_percent:.0} % of their extent remain";
            PositionsMirrored => "the positions are a mirror image of those of the tool", help: "swap two columns, or change the sign of one: the frame must be right-handed";
        }
        E1361 "positions are not taken here",
        cause: "This command compares lengths with a robot and has no tracker whose place it could find, or an option applies to lengths and there are none.",
        cure: "Give a table of lengths, or identify from the positions with `dbbd identify`.",
        asks: [Positions] {
            LengthsOnly => "positions are not taken by this command: it needs lengths";
            OfLengths { input: &'static str } => "{input} applies to lengths, but the input has only positions";
            PositionsTwice => "positions are added to lengths, but the input has positions already";
        }
        W1362 "lengths and positions contradict each other",
        cause: "Each kind of measurement alone fits better than both together: they were made of different robots, before and after a change, or with tables of axis angles that differ.",
        cure: "Identify from each alone and compare (`dbbd compare`); measure the kind of which you are less sure again." {
            KindsDisagree { apart_mm: f64, together_mm: f64 } => "fitted separately, lengths and positions leave residuals of {apart_mm:.3} mm; together {together_mm:.3} mm: they do not belong to one robot";
        }
    }
}

findings! {
    /// A file that is not a result.
    ResultFinding "Results as files" {
        E1901 "a file is not a result that can be compared",
        cause: "The file is not the result.json of `dbbd identify` nor the circle.json of `dbbd circle`, or another version of dbbd wrote it.",
        cure: "Give result.json or circle.json, or the directory that holds one. Make a result of another version again from its lengths." {
            NotJson { why: String } => "is not JSON: {why}";
            NeitherResultNorCircle => "is neither a result.json nor a circle.json";
            OtherSchema { schema: String, known: u32 } => "has schema {schema}, known is {known}";
            Incomplete { why: String } => "is not complete: {why}";
            NoFileInDirectory => "holds neither result.json nor circle.json";
        }
    }
}
