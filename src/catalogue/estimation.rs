//! Estimation: what is refused, and what is doubted or worth knowing of a result.

use std::fmt;

use serde::Serialize;

use super::findings;

/// Names in a sentence, separated by commas.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Names(pub Vec<String>);

impl Names {
    pub fn of<T: ToString>(names: impl IntoIterator<Item = T>) -> Self {
        Self(names.into_iter().map(|name| name.to_string()).collect())
    }
}

impl fmt::Display for Names {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.0.join(", "))
    }
}

findings! {
    /// What an estimation refuses, doubts or notes.
    EstimationFinding {
        E1301 "nothing can be computed from these lengths",
        cause: "A number is absurd (an angle, a length, a sigma, the tool ball or a base ball), options contradict each other, or none of the parameters asked for changes a length in these poses.",
        cure: "Check angles, lengths, sigmas, --tool and --centres. Ask for other parameters with --estimate, or vary the poses." {
            NotFinite => "a length or its derivative is not finite";
            NoFolds { folds: usize, lengths: usize } => "--folds {folds}: {lengths} lengths are cut into 2 folds or more, at most one for each length";
            SmallWorkspace { poses: usize, least: usize } => "{poses} poses are too few for a workspace: at least {least} are needed";
            NothingToEstimate => "none of the parameters asked for changes a length in these poses";
        }
        E1302 "an input of the estimation is missing",
        cause: "A capture carries the robot and the base balls of its plan; a table of lengths carries neither. A run of which no length matches a pose carries no measurement.",
        cure: "Give --robot NAME|FILE and --centres C.csv with a table. For a run, `dbbd sync` reports for each pose why it has no length." {
            NoRobot => "a table of lengths needs --robot NAME|FILE";
            NoBalls => "a table of lengths needs --centres C.csv with the base balls";
            NoLength => "no length matches a pose";
        }
        E1304 "a prior cannot be used",
        cause: "A row of the table `name,unit,sd` names a parameter twice, has another unit, or its sd is in another unit (degrees, micrometres); or what the robot's earlier identification left unknown is not in its file.",
        cure: "Correct the row; give the robot-identified.toml. The parameters.csv of an earlier identification of the same robot is such a table." {
            EmptyPrior => "the prior has no row with a standard deviation";
            OtherUnitThan { parameter: String, unit: String, given: String } => "`{parameter}` is in {unit}, not in `{given}`";
            ParameterTwice { parameter: String } => "`{parameter}` is there twice";
            NoPriorOf { parameter: String, value: f64, unit: String } => "no robot leaves `{parameter}` uncertain by {value} {unit}: is it in another unit?";
            NoPosterior => "the robot's file has no [posterior] of its values", help: "robot-identified.toml has it; or --prior datasheet";
        }
        E1305 "an argument of the estimation cannot be read",
        cause: "The text is not what the option takes.",
        cure: "Write what the message asks for; `dbbd identify --help` has an example of each." {
            PointInMetres => "three numbers in mm are needed: these seem to be in metres";
            NotAPoint => "three numbers in mm are needed, as 30,20,10";
        }
        W1310 "the solver did not converge",
        cause: "The start is too far from the truth: a base ball or the tool ball is elsewhere than given, or lengths and poses do not belong together.",
        cure: "Check the places of the base balls (--centres) and the tool ball (--tool)." {
            NotConverged { iterations: usize } => "the solver did not converge in {iterations} steps";
        }
        W1311 "the lengths fit worse than the nominal robot could",
        cause: "Lengths and poses do not belong together, or a base ball, the tool ball or the robot is another one: the ball was taught with another tool, or another plan was driven.",
        cure: "Check the plan, --centres, --tool and --robot." {
            FitsWorseThanNominal { residual_rms_mm: f64, predicted_max_mm: f64 } => "the lengths fit only to {residual_rms_mm:.2} mm, while the nominal robot is off by at most {predicted_max_mm:.2} mm";
        }
        W1312 "a correction or a place is not plausible",
        cause: "A part of the set-up that is fixed is elsewhere, or the robot is another one. A ball or bar that comes out far from where it was given is hardly observable in these poses, or was given wrongly.",
        cure: "Let the fixed part be estimated, or measure it again; check --robot. Turn the tool more, or fix a value that you trust." {
            ImplausibleWithFixed { fixed: Names, parameters: Names, times: f64 } => "with {fixed} fixed, the corrections of {parameters} are more than {times:.0} times the robot's tolerance";
            PlaceContradicted { fixed: Names, held_mm: f64, free_mm: f64 } => "with {fixed} fixed the lengths fit to {held_mm:.3} mm, and with these estimated to {free_mm:.3} mm: they are elsewhere";
            BarContradicted { off_mm: f64, sd_mm: f64 } => "by the robot's tolerance the lengths are those of a bar that is {off_mm:+.3} +- {sd_mm:.3} mm longer than stated: is its length right?";
            Implausible { parameters: Names, times: f64 } => "the corrections of {parameters} are more than {times:.0} times the robot's tolerance: no robot is so far off";
            Displaced { parameters: Names } => "{parameters} came out far from where they were given";
        }
        W1313 "more than one length in ten is an outlier",
        cause: "Lengths are matched to wrong poses, or the bar slipped: then the lengths that are left are doubtful too.",
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
            NoFreedom { lengths: usize, parameters: f64 } => "{lengths} lengths for {parameters:.0} parameters leave nothing to check the result by";
        }
        W1316 "the residuals are larger than the sigma given",
        cause: "The model lacks something (repeatability, reversal error, transmission error, sag, warming up, a ball that moved), or sigma is too small.",
        cure: "Give --sigma with the robot's repeatability in it, or measure more poses. report.html shows the residuals against each axis." {
            BeyondSigma { times: f64 } => "the residuals are {times:.1} times the sigma given, on which the standard deviations rest";
            BeyondSigmaOfFew { times: f64 } => "the residuals are {times:.1} times the sigma given; so few lengths cannot estimate another, so the standard deviations rest on the one given";
        }
        I1317 "the residuals are not those of the sigma in the data",
        cause: "Larger: the robot's repeatability or what the model lacks comes on top of the bar's noise. Smaller: sigma is too large, or lengths repeat each other.",
        cure: "Nothing: larger residuals are counted in the standard deviations. Correct sigma_mm if the standard deviations shall be as small as the residuals." {
            AboveSigma { times: f64 } => "the residuals are {times:.1} times the sigma given; the standard deviations rest on the residuals";
            BelowSigma { times: f64 } => "the residuals are only {times:.2} times the sigma given";
        }
        I1318 "the residuals show an error at a joint",
        cause: "The residuals follow the angle of an axis (transmission error, sag) or the sense of its motion (backlash, lag) beyond chance, and the model lacks it.",
        cure: "Come to every pose from the same side. Estimate `gear` or `compliance` if the error returns with the angle. The sense counts only if the rows are in the order of the measurement." {
            AngleError { axes: Names, rms_um: Vec<f64> } => "the residuals follow the angle of axis {axes} beyond chance";
            ReversalError { axes: Names, mrad: Vec<f64> } => "the residuals follow the sense of the motion of axis {axes} beyond chance";
        }
        W1319 "the lengths fit, but the position is not determined",
        cause: "A small residual is no proof: the predicted position error over the workspace is hardly smaller than that of the nominal robot, or larger.",
        cure: "Measure what the line `next:` recommends: a further ball or other circles. --prior datasheet keeps the rest near nominal." {
            PositionUndetermined { residual_rms_mm: f64, identified_mm: f64, nominal_mm: f64 } => "the lengths fit to {residual_rms_mm:.3} mm, but the predicted position error is {identified_mm:.2} mm, the nominal robot's {nominal_mm:.2} mm";
        }
        I1320 "the parameters listed improve the position only a little",
        cause: "--estimate lists few parameters; the others keep their nominal values.",
        cure: "Leave --estimate out, or measure what the line `next:` recommends." {
            ListImprovesLittle { residual_rms_mm: f64, identified_mm: f64, nominal_mm: f64 } => "the lengths fit to {residual_rms_mm:.3} mm, and the predicted position error is {identified_mm:.2} mm, the nominal robot's {nominal_mm:.2} mm";
        }
        I1321 "parameters are poorly observable",
        cause: "These poses determine them worse than three tolerances, so they are fixed at their start values.",
        cure: "Vary the poses, or use --prior datasheet." {
            PoorlyObservable { parameters: Names } => "fixed because they are poorly observable: {parameters}";
        }
        W1322 "the corrections are far larger than the prior allows",
        cause: "The robot is worse than the tolerance in its file (a crash, another arm, a lost mastering), or lengths and poses do not belong together.",
        cure: "Check [tolerance] in the robot file, the residuals and the held-out residuals; give wider standard deviations with --prior FILE." {
            FarBeyondPrior { times: f64 } => "the corrections are {times:.1} times as large as the prior allows";
        }
        I1323 "the corrections are larger than the prior allows",
        cause: "The robot is worse than the tolerance in its file.",
        cure: "Correct [tolerance] in the robot file, or give wider standard deviations with --prior FILE." {
            BeyondPrior { times: f64 } => "the corrections are {times:.1} times as large as the prior allows";
        }
        W1324 "Monte Carlo fits did not converge",
        cause: "The noise is so large that the lengths are far from linear in the parameters.",
        cure: "Check --sigma; measure more poses." {
            TrialsNotConverged { failed: usize, trials: usize } => "{failed} of {trials} Monte Carlo fits did not converge and do not count";
        }
        I1325 "Monte Carlo and linear intervals disagree",
        cause: "The lengths are not linear in these parameters over the width of the intervals.",
        cure: "Use the Monte Carlo intervals." {
            IntervalsDisagree { parameters: Names } => "Monte Carlo and linear 95 % intervals disagree for {parameters}";
        }
        I1326 "the identified robot has errors of its joints",
        cause: "The lengths speak for compliance, harmonics, smooth errors, backlash or ripple of the joints, so robot-identified.toml holds them. URDF, mastering offsets and programs that read only lengths and angles do without them.",
        cure: "Use `dbbd predict` and `dbbd compensate`, or the table joint-errors.csv. `--model geometric` identifies the robot that lengths and angles alone describe best." {
            BeyondTable { left_out_mm: f64 } => "robot-identified.toml holds errors of the joints: a program that reads only lengths and angles leaves out {left_out_mm:.3} mm in the mean over the workspace";
        }
        I1341 "a bar without a certificate is fixed",
        cause: "--hold fixes the offset of a bar whose uncertainty neither the job (length_u_mm) nor --bar-u states. Its length then counts as exact, in the standard deviations and in the predicted error too.",
        cure: "State the uncertainty of its length, or let the offset be estimated." {
            UncertifiedHeld => "the bar has no certificate, and its offset is fixed: its length counts as exact";
        }
        I1340 "the tolerance in the robot file is too small for this robot",
        cause: "The corrections are larger than [tolerance] lets expect. No prior was named, so the standard deviations of the prior were widened to what the lengths show.",
        cure: "Correct [tolerance] in the robot file." {
            PriorWidened { times: f64 } => "the corrections are {times:.1} times as large as the tolerance in the robot file lets expect; the prior is so much wider";
        }
        W1327 "the controller seems to use its own calibrated model",
        cause: "The lengths agree with the nominal robot better than its tolerance lets any robot do: in absolute-accuracy mode, or in the run of a corrected program, the axes are not at the angles that are given; or the lengths are the commanded ones.",
        cure: "Give the axis angles that the program logged: `dbbd sync --axes`, then identify its observations. Give lengths that the bar measured." {
            AbsoluteAccuracyMode { residual_rms_mm: f64, expected_mm: f64 } => "the lengths agree with the nominal robot to {residual_rms_mm:.3} mm; its tolerance lets {expected_mm:.2} mm expect";
        }
        W1328 "the run is doubtful",
        cause: "A part of the run is damaged, the bar was mounted badly (W0280 to W0284), or its poses were planned for another robot.",
        cure: "`dbbd info` names the damages. Give the robot of the plan, or plan for this one." {
            PartOfRunLost => "a part of the run was lost or is not as it should be";
            PlannedForAnother { planned: String, given: String } => "the poses are of a plan for {planned}, --robot names {given}";
        }
        W1330 "the lengths seem to belong to other rows",
        cause: "With the column of the lengths moved by some rows they fit decisively better: a row was lost or inserted in the table or in the trace.",
        cure: "Compare the first and the last rows of poses and lengths; give the lengths to their own poses. `gain` is the natural logarithm of the likelihood ratio." {
            ShiftedRows { rows: isize, residual_mm: f64, shifted_mm: f64, gain: f64 } => "with each length moved by {rows} row(s) the residual falls from {residual_mm:.4} mm to {shifted_mm:.4} mm (likelihood ratio e^{gain:.0})";
        }
        W1331 "a base ball was mounted anew amid the data",
        cause: "From one row on the lengths to a ball are to another place: it was mounted again, knocked or moved in its cup, and the table does not say so. The lengths after that row then got a ball of their own.",
        cure: "Give the later lengths a number of their own in the column `centre`, and a row of --centres. If nothing was moved, look for what else changed at that row: the bar, its zero, the tool ball. `gain` is the natural logarithm of the likelihood ratio." {
            Remounted { ball: u32, index: u32, new: u32, moved_mm: f64, residual_mm: f64, apart_mm: f64, gain: f64 } => "from index {index} on ball {ball} is {moved_mm:.3} mm from where it was: these lengths are of ball {new} in the result; the residual falls from {residual_mm:.4} mm to {apart_mm:.4} mm (likelihood ratio e^{gain:.0})";
        }
        W1332 "what an earlier identification knew is lost",
        cause: "The robot was identified before, and its file does not hold how well: it was written by an older version, or its values were changed since. These lengths alone then stand for all that is known, so that the predicted position error can rise.",
        cure: "Give the robot-identified.toml as it was written; or identify the earlier lengths together with these. `--prior none` begins anew without a word." {
            PosteriorLost => "the robot was identified before, but its file has no [posterior]: what these lengths do not determine is fixed as if it were exact or known by the tolerance alone";
            PosteriorOfOtherValues => "[posterior] is of other values than the robot's: they were changed since, and it is not used";
        }
        W1333 "what is measured from changed amid the data",
        cause: "Beside all that was estimated, the residuals show a step at one row, or a drift over the rows, of the zero of a bar or of the frame of the tracker: the bar was reset, knocked or became warm, its counter lost a count, the tracker moved; or a column of the table was sorted. It was taken out, as if all were measured from where the first row is.",
        cure: "Check the zero of the bar before and after a run, and let bar and robot become warm first. Measure anew what must be certain: the first zero may be the wrong one." {
            ZeroStep { bar: u32, index: u32, by_mm: f64, sd_mm: f64 } => "from index {index} on the lengths of bar {bar} are {by_mm:.4} mm (standard uncertainty {sd_mm:.4} mm) too long beside those before: this was taken out";
            ZeroDrift { bar: u32, by_mm: f64, sd_mm: f64 } => "the lengths of bar {bar} drift by {by_mm:.4} mm (standard uncertainty {sd_mm:.4} mm) from the first row to the last: this was taken out";
            TrackerStep { index: u32, size_mm: f64, sd_mm: f64 } => "from index {index} on the tracker's frame is {size_mm:.4} mm (standard uncertainty {sd_mm:.4} mm) from where it was: this was taken out";
            TrackerDrift { size_mm: f64, sd_mm: f64 } => "the tracker's frame drifts by {size_mm:.4} mm (standard uncertainty {sd_mm:.4} mm) from the first row to the last: this was taken out";
        }
        W1334 "lengths that identified the robot are used again",
        cause: "Most of these lengths are in the lengths.csv beside the robot's file, so its [posterior] holds them already. Counted twice, they would promise an accuracy that they do not have.",
        cure: "Nothing: [posterior] is not used. To identify anew, give the nominal robot; to go on, give only new lengths." {
            KnownLengths { known: usize, lengths: usize } => "{known} of {lengths} lengths identified this robot already: its [posterior] is not used";
        }
        W1381 "the residuals are far above what the robot repeats",
        cause: "The lengths do not belong to their poses (a column sorted or shifted, bars of two lengths under one number, another unit), or the model lacks most of the error (transmission error, backlash, sag, a list of parameters that is too short).",
        cure: "Look at the residuals in report.html: by row they show a mistake in the table, by axis an error of a joint. Check `bar`, `centre`, --robot and --estimate." {
            BeyondRepeatability { residual_rms_mm: f64, repeatability_mm: f64 } => "the lengths fit to {residual_rms_mm:.3} mm, and the robot repeats to {repeatability_mm:.3} mm along a length";
        }
        W1382 "lengths that only check do not fit",
        cause: "They are of another robot, another mounting of the ball, another bar or other poses than the lengths that identified the robot.",
        cure: "Check where the lengths of --validate come from." {
            HeldOutDiffers { held_out_mm: f64, residual_rms_mm: f64 } => "the lengths that only check fit to {held_out_mm:.3} mm, and those that were used to {residual_rms_mm:.3} mm";
        }
        I1380 "no further measurement could be judged",
        cause: "What further measurements would leave is not a finite number, as with standard deviations of the lengths that differ by more than a computer's numbers hold.",
        cure: "Check sigma_mm of the lengths, --sigma and [tolerance] of the robot file." {
            NoRecommendation => "what further measurements would add is not a finite number: none is recommended";
        }
        E1360 "positions do not follow the poses of the robot",
        cause: "The rows are of another robot, positions and axis angles were put together in another order, columns were swapped, or the frame is left-handed.",
        cure: "Compare one row with the robot: which pose, and which place. Give the coordinates in a right-handed frame." {
            PositionsElsewhere { misfit_percent: f64 } => "the positions are not where the robot has its tool in any place of the tracker: {misfit_percent:.0} % of their extent remain";
            PositionsMirrored => "the positions are a mirror image of where the robot has its tool", help: "swap two columns, or change the sign of one: the frame must be right-handed";
        }
        E1361 "positions are not taken here",
        cause: "This command compares lengths with a robot and has no tracker whose place it could find, or an option is about lengths and there are none.",
        cure: "Give a table of lengths, or identify from the positions with `dbbd identify`." {
            LengthsOnly => "positions are not taken by this command: it needs lengths";
            OfLengths { option: &'static str } => "{option} is about lengths, and the input has positions alone";
            PositionsTwice => "--positions is for positions beside lengths: the input has positions already";
        }
        W1362 "lengths and positions contradict each other",
        cause: "Each kind of measurement alone fits better than both together: they were made of different robots, before and after a change, or with tables of axis angles that differ.",
        cure: "Identify from each alone and compare (`dbbd compare`); measure the kind that is in doubt again." {
            KindsDisagree { apart_mm: f64, together_mm: f64 } => "lengths and positions alone leave residuals of {apart_mm:.3} mm, together {together_mm:.3} mm: they are not of one robot";
        }
    }
}
