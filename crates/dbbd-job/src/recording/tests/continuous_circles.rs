//! A continuous circle is planned, emitted, driven and reported as one motion per pass.

use dbbd_job::plan::{Job, Plan, PoseKind};
use dbbd_job::program::krl::{self, Options, Sync, emit};
use dbbd_job::recording::matching::{MatchOutcome, MatchingInput, PoseOutcome, match_poses};
use dbbd_job::recording::{SampleStream, StreamBuilder};
use dbbd_job::sim::SimulatedController;
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Finding;
use dbbd_model::measurement::sample::Sample;

use crate::test_support::cell::kr60;
use crate::test_support::krl::program;

const RADIUS_MM: f64 = 300.0;

fn text(circle: &str) -> String {
    format!(
        "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = {RADIUS_MM:?}\nstroke_mm = [-6.0, 6.0]\n[[centre]]\nid = 1\n\
         xyz_mm = [1300.0, 0.0, 800.0]\n[[circle]]\nmode = \"continuous\"\n{circle}\n[motion]\nfeed_mm_s = 60.0\n"
    )
}

fn job(circle: &str) -> Job {
    Job::from_toml("job.toml", &text(circle)).unwrap()
}

const BOTH: &str =
    "plane = \"XY\"\npoints = 72\norientation = \"fixed\"\ntilt_deg = 20.0\ndirection = \"both\"";
const ARC: &str = "plane = \"XZ\"\npoints = 61\norientation = \"fixed\"\ntilt_deg = 20.0\ndirection = \"cw\"\nstart_deg = 170.0\n\
     arc_deg = 150.0\novershoot_deg = 10.0";

/// The simulated controller is at the planned position along the pass at each commanded time.
#[test]
fn controller_follows_the_passes() {
    for circle in [BOTH, ARC] {
        let plan = Plan::build(&job(circle), &kr60()).unwrap();
        assert_eq!(plan.header.passes.len(), if circle == BOTH { 2 } else { 1 });
        for (sync, kind) in [
            (Sync::Output, krl::Controller::Krc4),
            (Sync::Output, krl::Controller::Krc2),
            (Sync::Marker, krl::Controller::Krc5),
        ] {
            let files = emit(&plan, Options { sync, controller: kind }).unwrap();
            let scirc = files.iter().any(|(_, text)| text.contains("\r\nSCIRC XP["));
            assert_eq!(scirc, kind != krl::Controller::Krc2);
            let mut controller = SimulatedController::new(program(&files), &kr60(), 100.0).unwrap();
            let geometry = kr60().geometry;
            let (mut begun, mut worst, mut done) = (None, 0.0_f64, 0);
            loop {
                let moment = controller.step(0.01).unwrap();
                if moment.halted {
                    controller.go_on();
                }
                if moment.done {
                    break;
                }
                if sync != Sync::Output {
                    continue;
                }
                match (moment.strobe, begun) {
                    // The pulses of the marks last 0.2 s.
                    (true, None) => begun = Some(moment.t_s),
                    (true, Some(begun_s)) if moment.t_s - begun_s > 0.25 => {
                        let pass = &plan.header.passes[done];
                        let path = plan.pass_path(pass).unwrap();
                        // The strobe rose within the step before.
                        let off = [-0.01, -0.005, 0.0, 0.005]
                            .map(|early| {
                                path.pose(pass.share(moment.t_s - begun_s - early)).unwrap().position
                            })
                            .map(|there| (geometry.ball(&moment.axes).position - there).norm());
                        worst = worst.max(off.into_iter().fold(f64::INFINITY, f64::min));
                    }
                    (false, Some(begun_s)) => {
                        if moment.t_s - begun_s > 0.25 {
                            let pass = plan.header.passes[done];
                            assert!((moment.t_s - begun_s - pass.duration_s).abs() < 0.03);
                            done += 1;
                        }
                        begun = None;
                    }
                    _ => {}
                }
            }
            let passes = plan.header.passes.len();
            assert_eq!(controller.dwells() as usize, passes);
            if sync == Sync::Output {
                assert_eq!(done, passes);
                assert!(worst < 0.2, "{worst} mm beside the path: more than 60 mm/s in 2.5 ms");
            }
        }
    }
}

/// The points of a pass lie on its path at the shares given by their times, and the times add up.
#[test]
fn points_lie_at_their_times() {
    for circle in [BOTH, ARC] {
        let plan = Plan::build(&job(circle), &kr60()).unwrap();
        let (csv, json) = plan.to_files().unwrap();
        assert_eq!(Plan::from_files("plan.csv", &csv, "plan.json", &json).unwrap(), plan);
        for pass in &plan.header.passes {
            let path = plan.pass_path(pass).unwrap();
            let mut t_s = 0.0;
            for index in pass.points[0]..=pass.points[1] {
                let row = &plan.rows[index as usize - 1];
                assert!(row.kind == PoseKind::Measure && row.is_passed());
                t_s += plan.header.moves[index as usize - 1].duration_s;
                let share = pass.share(t_s);
                assert!((pass.time_s(share) - t_s).abs() < 1e-9);
                let off = (path.pose(share).unwrap().position - nalgebra::Vector3::from(row.xyz_mm)).norm();
                // Three printed points determine the circle, each to half a micrometre per coordinate.
                assert!(off < 0.004, "row {index}: {off} mm");
            }
            t_s += plan.header.moves[pass.end as usize - 1].duration_s;
            assert!((t_s - pass.duration_s).abs() < 1e-9);
            let places = plan.circle_places();
            let place = places[pass.points[0] as usize - 1].unwrap();
            assert_eq!(place.clockwise, pass.clockwise);
        }
    }
}

/// A strobe for each dwell and pass of the plan but those of `left_out`, on a bar that does not move.
fn strobed(plan: &Plan, left_out: usize) -> SampleStream {
    let mut stream = StreamBuilder::new(None);
    let mut t_ms = 0_u64;
    let mut run = |seconds: f64, strobe: bool| {
        for _ in 0..(seconds * 100.0) as u32 {
            let sample = Sample { trigger: Some(strobe), ..Sample::of(0.0) };
            stream.push(HostNs(t_ms * 1_000_000), &sample);
            t_ms += 10;
        }
    };
    let pass = |index: u32| plan.header.passes.iter().find(|pass| pass.end == index);
    let stops = plan.rows.iter().filter_map(|row| match pass(row.index) {
        Some(pass) => Some(pass.duration_s),
        None => (row.dwell_s > 0.0).then_some(row.dwell_s),
    });
    for seconds in stops.skip(left_out) {
        run(2.0, false);
        run(seconds + 0.01, true);
    }
    run(2.0, false);
    stream.build()
}

#[test]
fn pass_of_unknown_time_or_lag_has_a_code() {
    let plan = Plan::build(&job(ARC), &kr60()).unwrap();
    let matching = match_poses(&MatchingInput::new(&plan, &strobed(&plan, 0)));
    assert!(
        matching.findings.iter().any(|finding| finding.code().as_str() == "I1013"),
        "{:?}",
        matching.findings
    );
    let matching = match_poses(&MatchingInput::new(&plan, &strobed(&plan, 1)));
    let lost = |pose: &PoseOutcome| match &pose.outcome {
        MatchOutcome::Missing { reason } => reason.code().as_str() == "I1024",
        _ => false,
    };
    assert!(matching.outcomes.iter().any(lost), "{:?}", matching.outcomes);
}

#[test]
fn impossible_continuous_motion_is_refused() {
    for (circle, line, code) in [
        ("plane = \"XY\"\npoints = 72", 10, "E0605"),
        ("plane = \"XY\"\npoints = 5\norientation = \"fixed\"", 13, "E0130"),
        ("plane = \"XY\"\npoints = 72\norientation = \"fixed\"\novershoot_deg = 0.5", 15, "E0605"),
        ("plane = \"XY\"\npoints = 72\norientation = \"fixed\"\novershoot_deg = 200.0", 15, "E0130"),
    ] {
        let wrong = Job::from_toml("job.toml", &text(circle)).unwrap_err();
        assert_eq!((wrong.line_number(), wrong.code().as_str()), (line, code), "{wrong}");
    }
    // A plan whose rows and passes contradict.
    let plan = Plan::build(&job(ARC), &kr60()).unwrap();
    let (csv, json) = plan.to_files().unwrap();
    let read = |json: &str| Plan::from_files("plan.csv", &csv, "plan.json", json).unwrap_err().to_string();
    let end = plan.header.passes[0].end;
    assert!(read(&json.replace(&format!("\"end\": {end}"), "\"end\": 3")).contains("names other rows"));
    assert!(read(&json.replace("\"sweep_deg\": 170.0", "\"sweep_deg\": 1e9")).contains("cannot be"));
    let mut lost = plan.clone();
    lost.rows[end as usize - 1].motion = dbbd_job::plan::MotionKind::Lin;
    let (csv, json) = lost.to_files().unwrap();
    let message = Plan::from_files("plan.csv", &csv, "plan.json", &json).unwrap_err().to_string();
    assert!(message.starts_with("plan.csv:") && message.contains("a pass without stops is"), "{message}");
}
