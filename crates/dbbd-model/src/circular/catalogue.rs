//! The circular test.

use crate::findings;

findings! {
    /// Lengths on a circle that cannot be evaluated, and what limits an evaluation.
    CircularFinding "The circular test" {
        E1401 "a circle has too few lengths",
        cause: "A trace has too few points for a circle and deviations from it.",
        cure: "Measure more points, or leave the trace out." {
            NoLength => "there is no length on a circle";
            TooFewPoints { run: String, direction: &'static str, points: usize, least: usize } => "run {run}, {direction}: {points} points are too few, at least {least} are needed";
        }
        E1402 "a length is not one of a circle of this radius",
        cause: "The nominal radius is not that of the lengths, or lengths are in another unit.",
        cure: "Give the programmed radius; lengths are between the ball centres, in mm.",
        asks: [Radius] {
            Radius { radius_mm: f64 } => "the nominal radius must be positive: {radius_mm} mm";
            FarFromRadius { run: String, direction: &'static str, angle_deg: f64, length_mm: f64, radius_mm: f64 } => "run {run}, {direction}: a length of {length_mm} mm at {angle_deg} degrees is far from the nominal radius of {radius_mm} mm: is the radius right?";
        }
        E1403 "the points determine no circle",
        cause: "Their angles are too few or too near to each other.",
        cure: "Measure points over a longer arc." {
            NoCircle => "the points determine no circle: their angles are too few or too near to each other";
        }
        E1404 "a cell of a circular test is not possible",
        cause: "The cell holds a word that the column does not have.",
        cure: "A circular test has the columns run,direction,angle_deg,length_mm[,t_s,temp_c]; direction is cw or ccw." {
            Direction { cell: String } => "column `direction`: `{cell}` must be cw or ccw";
        }
        I1410 "an arc is not the full circle",
        cause: "The lengths cover an arc only. A short one does not determine its centre.",
        cure: "Measure the full circle, or a longer arc, for all quantities (docs/reference/circular-test.md)." {
            ArcWithoutCentre { span_deg: f64, condition: f64, most: f64 } => "the arc of {span_deg:.0} degrees does not determine its centre (condition {condition:.0}, at most {most} is accepted): G, G(b), H, D and the centre are refused; F is about the instrument's centre";
            PartialArc { span_deg: f64, condition: f64 } => "partial arc of {span_deg:.0} degrees (condition {condition:.1}): centre and radius are fitted jointly; F is about the instrument's centre";
        }
        I1411 "a trace does not run in its direction",
        cause: "Most of its angles change against the direction that the file gives.",
        cure: "Check the column `direction`." {
            AgainstDirection { run: String, direction: &'static str } => "run {run}: its angles do not run {direction} as its direction says";
        }
        I1412 "lengths are not referred to 20 degrees Celsius",
        cause: "Temperatures or the expansion of bar and machine were not given.",
        cure: "Record temperatures, and give the expansion of bar and machine.",
        asks: [Expansion, MachineExpansion] {
            BarAsMeasured => "the circle is referred to 20 degrees by the expansion of the machine only: the bar is taken as not expanding";
            AsMeasured => "lengths are as measured: no temperatures with an expansion were given";
        }
        I1413 "the nominal radius is assumed",
        cause: "A CSV does not carry the programmed radius.",
        cure: "Give the programmed radius.",
        asks: [Radius] {
            RadiusAssumed { radius_mm: f64 } => "no radius was given: the nominal radius is taken to be {radius_mm} mm";
        }
        W1415 "poses of a circle have no length",
        cause: "Their dwells could not be matched or read.",
        cure: "`dbbd sync` gives the reason for each pose. Measure the circle again where much of it is missing." {
            PosesWithoutLength { lost: usize, poses: usize, percent: f64 } => "{lost} of {poses} poses ({percent:.1} %) have no length (`dbbd sync` gives the reasons)";
            CircleWithoutLength { circle: u32, poses: usize } => "circle {circle}: none of its {poses} poses has a length, so it is left out";
        }
        E1481 "an input applies only to captures or to circles with temperatures",
        cause: "A plan and logged axes belong to the poses of a recorded run; a CSV of a circle has none. An expansion needs temperatures (the column temp_c); the temperature of the certificate needs the expansion of the bar.",
        cure: "Leave the input out, or give the capture, the temperatures or the expansion.",
        asks: [Plan, LoggedAxes, Expansion, CertificateTemperature] {
            NoTemperature { input: &'static str } => "{input} needs temperatures, but no circle has a temperature for each length";
            CertifiedAlone => "the temperature of the certificate needs the expansion of the bar";
            NoCapture => "a plan and logged axes apply only to a capture";
        }
        W1480 "lengths are not those of a circular test",
        cause: "A length is mistyped or the bar slipped at it, the lengths are the nominal ones, rounded or frozen, a ball moved or the zero changed between the two directions, or the radius is that of another circle.",
        cure: "Correct or leave out the row that is named; give the lengths that the bar measured, and the programmed radius.",
        asks: [Radius] {
            Spike { run: String, angle_deg: f64, off_mm: f64 } => "run {run}: at {angle_deg:.1} degrees the length is {off_mm:+.3} mm from those beside it";
            OtherRadius { mean_mm: f64, radius_mm: f64 } => "the mean length is {mean_mm:.3} mm, and the nominal radius {radius_mm} mm";
            RoundedLengths { step_um: f64 } => "the lengths are rounded to {step_um:.0} um, which the intervals do not include";
            EqualRun { run: String, points: usize, angle_deg: f64, length_mm: f64 } => "run {run}: from {angle_deg:.1} degrees on {points} lengths are {length_mm:.4} mm: was the bar frozen?";
            RadiiApart { apart_um: f64 } => "the mean lengths of the two directions differ by {apart_um:+.1} um: did the zero change between them?";
            CentresApart { apart_um: f64 } => "only the centres of the two directions differ, by {apart_um:.1} um: did a ball move between them?";
            LargeDeviation { g_mm: f64, radius_mm: f64 } => "the circular deviation is {g_mm:.3} mm at a radius of {radius_mm} mm: are the deviations in another unit?";
            RadiusOfPlan { radius_mm: f64, planned_mm: f64 } => "the radius is {radius_mm} mm, and the plan that was driven has {planned_mm} mm";
            EqualLengths { length_mm: f64 } => "all lengths are {length_mm:.4} mm: were they measured?";
        }
        W1482 "rows, angles, times, temperatures or the standard deviation of a circle are impossible",
        cause: "A file was joined with itself, angle_deg is in another unit than degrees, counts points or counts on over the runs, rows of several runs or senses have one number and direction, a pass was cut off, t_s is in ms, temp_c is in another unit than degrees Celsius or of several sensors, or the standard deviation of a length is in another unit than mm.",
        cure: "Give each row once, each run its own number in the column `run`, angles in degrees, times in s, temperatures in degrees Celsius and the standard deviation in mm; pass the whole circle in each sense.",
        asks: [Sigma] {
            RowsTwice { run: String, rows: usize } => "run {run}: {rows} rows are duplicates";
            ManyTurns { run: String, span_deg: f64 } => "run {run}: the angles span {span_deg:.0} degrees in one sense";
            CountedPoints { run: String, points: usize } => "run {run}: the angles count the {points} points: degrees are needed";
            Gon { run: String, last_deg: f64 } => "run {run}: the angles go to {last_deg:.1} in equal steps that divide 400: are they in gon?";
            TurnsBack { run: String, direction: &'static str, steps: usize } => "run {run}, {direction}: {steps} steps are against the direction: are two senses in one run?";
            UnequalSenses { ccw_deg: f64, cw_deg: f64 } => "{ccw_deg:.0} degrees are passed counter-clockwise and {cw_deg:.0} clockwise: what needs both senses, such as G(b) and H, is refused";
            LongTest { run: String, span_s: f64 } => "run {run}: the times span {span_s:.0} s: are they in ms?";
            SigmaTooSmall { sigma_um: f64, scatter_um: f64 } => "the standard deviation is {sigma_um} um, and the lengths scatter by {scatter_um:.1} um";
            SigmaTooLarge { sigma_um: f64, scatter_um: f64 } => "the standard deviation is {sigma_um} um, and the lengths scatter by {scatter_um:.1} um only";
            TimesBack { run: String, t_s: f64 } => "run {run}: the times go back at t_s = {t_s}";
            WarmedBar { span_k: f64 } => "`temp_c` spans {span_k:.1} K in one test";
        }
        I1416 "reversal steps of joints are not separable",
        cause: "The reversal of a joint is separated from the shape of the circle by poses that were measured in both directions. The circle was driven in one direction, the directions have too few poses in common, or their joints move alike.",
        cure: "Plan the circle with `direction = \"both\"`, and with enough points." {
            StepsNotSeparable { joints: usize } => "{joints} joints reverse along the circle; their steps cannot be separated from its shape";
        }
    }
}
