//! All methods of matching lengths to poses give the same robot: sync markers, strobe, EthernetKRL, and passes without
//! stops, each with its program from the plan, on the same simulated robot.

use dbbd_job::plan::{Job, Plan};
use dbbd_job::program::krl::{self, Program, Sync, emit};
use dbbd_job::recording::matching::{DwellSource, MatchingInput, PoseMatching, PoseOutcome, match_poses};
use dbbd_job::recording::{
    DeviceClock, DwellReport, StreamBuilder, TelegramReader, TelegramResult, reported_axes,
};
use dbbd_job::sim::world::WorldSetup;
use dbbd_job::sim::{SimulatedController, World};
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::estimation::{CompletedCalibration, Options, result::Status};
use dbbd_model::measurement::BaseBall;
use dbbd_model::measurement::sample::Sample;
use dbbd_model::robot::{BallId, Robot};

use crate::test_support::cell::{CENTRE, calibrated, kr60, with_errors};

const RATE_HZ: f64 = 250.0;
/// Delays of the bar's samples and the controller's telegrams, ns.
const LATE_NS: u64 = 8_000_000;

fn plan(continuous: bool) -> Plan {
    let circle = |normal: &str, more: &str| {
        format!("[[circle]]\nnormal = {normal}\norientation = \"fixed\"\ntilt_deg = 25.0\n{more}\n")
    };
    let mode = if continuous {
        "points = 72\ndirection = \"both\"\nmode = \"continuous\"\n"
    } else {
        "points = 24\n"
    };
    let circles =
        ["[0.0, 0.0, 1.0]", "[0.6, 0.0, 0.8]", "[0.0, -0.6, 0.8]"].map(|normal| circle(normal, mode));
    let job = format!(
        "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-6.0, 6.0]\n[[centre]]\nid = 1\n\
         xyz_mm = [1300.0, 0.0, 800.0]\n{}[motion]\nsettle_s = 0.4\ndwell_s = 0.5\nfeed_mm_s = 60.0\n",
        circles.concat()
    );
    Plan::build(&Job::from_toml("job.toml", &job).unwrap(), &kr60()).unwrap()
}

/// Result of a run of the program: the matched lengths.
fn driven(plan: &Plan, sync: Sync, override_percent: f64, seed: u64, truth: &Robot) -> PoseMatching {
    let files = emit(plan, krl::Options { sync, controller: krl::Controller::Krc4 }).unwrap();
    let program = Program::open("DBB_MAIN", |wanted| {
        Ok(files.iter().find(|(name, _)| name.eq_ignore_ascii_case(wanted)).cloned())
    })
    .unwrap();
    // No repeatability error: a pass is one motion, so an error common to its points shows in no residual.
    let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| CENTRE[axis] + CENTRE_ERRORS[axis]);
    let world = format!("[[centre]]\nid = 1\nxyz_mm = [{x:?}, {y:?}, {z:?}]\n[bar]\nnoise_um = 2.0\n");
    let setup = WorldSetup::new(&program.setups(), Some(("world.toml", &world))).unwrap();
    let mut world = World::new(truth.geometry.clone(), setup, seed);
    let mut controller = SimulatedController::new(program, &kr60(), override_percent).unwrap();
    controller.link_ekrl();
    let mut stream = StreamBuilder::new(Some(DeviceClock { seconds_per_tick: 1e-6, wrap: Some(1 << 32) }));
    let (mut reader, mut reports) = (TelegramReader::default(), Vec::new());
    let mut halted = 0;
    for number in 0_u64.. {
        let moment = controller.step(1.0 / RATE_HZ).unwrap();
        let host = HostNs((number as f64 / RATE_HZ * 1e9) as u64 + LATE_NS);
        while let Some(telegram) = controller.telegram() {
            for heard in reader.push(telegram.as_bytes()) {
                let TelegramResult::Telegram(told) = heard else { panic!("{heard:?}") };
                let (index, phase, axes_deg) = (told.index, told.phase, told.axes_deg);
                reports.push(DwellReport { host, index, phase, axes_deg });
                controller.answer(i64::from(index));
            }
        }
        // The bar is mounted at a HALT of some seconds.
        halted += u32::from(moment.halted);
        if moment.halted && halted % 1000 == 0 {
            controller.go_on();
        }
        if moment.done {
            break;
        }
        let measured = world.reading(&moment);
        let sample = Sample {
            sequence: Some(number as u32),
            ticks: Some(DeviceTicks((number as f64 / RATE_HZ * 1e6) as u64)),
            trigger: (sync == Sync::Output).then_some(moment.strobe),
            valid: measured.in_stroke,
            ..Sample::of(measured.reading_mm)
        };
        stream.push(host, &sample);
    }
    let stream = stream.build();
    let axes = reported_axes(&reports);
    match_poses(&MatchingInput {
        reports: &reports,
        axes_deg: (!axes.is_empty()).then_some(&axes),
        ..MatchingInput::new(plan, &stream)
    })
}

/// What the true robot has and what is estimated: errors (rad, mm) that three circles with the tool held in one
/// orientation tell apart.
pub(crate) const ERRORS: [(&str, f64); 9] = [
    ("alpha1", 4e-4),
    ("alpha2", -3e-4),
    ("alpha3", 5e-4),
    ("a1", 0.3),
    ("a2", -0.25),
    ("theta2", 6e-4),
    ("theta3", -4e-4),
    ("theta4", 5e-4),
    ("beta2", 3e-4),
];
pub(crate) const CENTRE_ERRORS: [f64; 3] = [0.4, -0.3, 0.5];

/// The errors and the ball's place by a run.
pub(crate) fn calibration(matching: &PoseMatching) -> CompletedCalibration {
    let axes = ["centre1_x", "centre1_y", "centre1_z"];
    let estimate = ERRORS.iter().map(|(name, _)| *name).chain(axes).map(|name| name.parse().unwrap());
    let options = Options { estimate: Some(estimate.collect()), ..Options::default() };
    let centre = BaseBall { id: BallId::FIRST, position: CENTRE.into() };
    calibrated(&kr60(), &matching.observations, &[centre], &options).unwrap()
}

/// What is found for the errors and the ball's place, each with its standard deviation.
fn identified(matching: &PoseMatching) -> Vec<(String, f64, f64)> {
    let found = calibration(matching);
    let all = found.result.parameters.iter().filter(|parameter| parameter.status == Status::Identified);
    all.map(|found| (found.name.to_string(), found.correction, found.sd.unwrap())).collect()
}

#[test]
fn marker_strobe_telegrams_and_passes_give_the_same_robot() {
    let truth = with_errors(ERRORS);
    let [stops, passes] = [false, true].map(plan);
    let server = "127.0.0.1:54600".parse().unwrap();
    let ways = [
        ("marker", &stops, Sync::Marker, 100.0, DwellSource::Stillness),
        ("output", &stops, Sync::Output, 80.0, DwellSource::Strobe),
        ("ekrl", &stops, Sync::Ekrl { server }, 60.0, DwellSource::Reports),
        ("passes", &passes, Sync::Output, 90.0, DwellSource::Strobe),
        ("passes, ekrl", &passes, Sync::Ekrl { server }, 100.0, DwellSource::Reports),
    ];
    let mut all = Vec::new();
    for (seed, (way, plan, sync, override_percent, source)) in (1..).zip(ways) {
        let matching = driven(plan, sync, override_percent, seed, &truth);
        let matched = matching.outcomes.iter().filter_map(PoseOutcome::reading).count();
        assert_eq!(matching.source, source, "{way}");
        assert!(
            10 * matched >= 9 * matching.outcomes.len(),
            "{way}: {matched} of {}",
            matching.outcomes.len()
        );
        let found = identified(&matching);
        eprintln!(
            "{way}: {matched} of {} poses, mean sigma {:.2} um, lags {:?}",
            matching.outcomes.len(),
            1e3 * matching.observations.rows.iter().filter_map(|row| row.sigma_mm).sum::<f64>()
                / matched as f64,
            matching
                .lags
                .iter()
                .map(|lag| format!("{:.1} +- {:.1} ms", 1e3 * lag.lag_s, 1e3 * lag.sd_s))
                .collect::<Vec<_>>()
        );
        all.push((way, found));
    }
    let true_errors = ERRORS.iter().map(|(_, error)| *error).chain(CENTRE_ERRORS);
    let true_errors: Vec<f64> = true_errors.collect();
    let rms = |standard: &[f64]| (standard.iter().map(|z| z * z).sum::<f64>() / standard.len() as f64).sqrt();
    let most = |standard: &[f64]| standard.iter().fold(0.0, |most: f64, z| most.max(z.abs()));
    for (at, (way, found)) in all.iter().enumerate() {
        assert_eq!(found.len(), true_errors.len(), "{way}: {found:?}");
        let off: Vec<f64> =
            found.iter().zip(&true_errors).map(|((_, value, sd), error)| (value - error) / sd).collect();
        eprintln!("{way} against the truth: rms {:.2} sd, worst {:.2} sd", rms(&off), most(&off));
        assert!(rms(&off) < 2.0 && most(&off) < 4.0, "{way}: {off:.2?}");
        for (other, theirs) in &all[..at] {
            let apart: Vec<f64> = found
                .iter()
                .zip(theirs)
                .map(|((_, here, sd), (_, there, their_sd))| (here - there) / sd.hypot(*their_sd))
                .collect();
            eprintln!("{way} against {other}: rms {:.2} sd, worst {:.2} sd", rms(&apart), most(&apart));
            assert!(rms(&apart) < 2.0 && most(&apart) < 4.0, "{way} against {other}: {apart:.2?}");
        }
    }
}
