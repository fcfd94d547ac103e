//! Properties of emitting and reading KRL, on random plans and programs.

use dbbd_job::plan::{Job, MotionKind, Plan};
use dbbd_job::program::Correction;
use dbbd_job::program::Target;
use dbbd_job::program::krl::{
    Controller, Files, Given, Options, Sync, Text, compensate, emit, logged_axes, parse_data, plan_hash, read,
};
use dbbd_job::sim::truth;
use dbbd_model::robot::Robot;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::test_support::cell::kr60;
use crate::test_support::circle_plan;
use crate::test_support::krl::{motions, program};

/// A plan with random poses, bits, speeds and times within the limits of KRL; one in two has continuous passes.
fn random_plan(seed: u64) -> Plan {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut plan = if seed.is_multiple_of(2) {
        circle_plan::plan(random.random_range(1..4), random.random_range(3..30))
    } else {
        let job = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-6.0, 6.0]\n[[centre]]\nid = 1\n\
                   xyz_mm = [1300.0, 0.0, 800.0]\n[[circle]]\nmode = \"continuous\"\nplane = \"XY\"\npoints = 12\n\
                   orientation = \"fixed\"\ntilt_deg = 20.0\ndirection = \"both\"";
        Plan::build(&Job::from_toml("job.toml", job).unwrap(), &kr60()).unwrap()
    };
    let mut within = |most: f64, parts: f64| (random.random_range(-most..most) * parts).round() / parts + 0.0;
    for row in &mut plan.rows {
        row.xyz_mm = [0; 3].map(|_| within(3500.0, 1e3));
        row.abc_deg = [0; 3].map(|_| within(180.0, 1e4));
        row.status = within(3.49, 1.0).abs() as u8;
        row.turn = within(63.0, 1.0).abs() as u8;
    }
    for time in &mut plan.header.moves {
        time.feed_mm_s = 1.0 + within(200.0, 1e3).abs();
        time.turn_deg_s = 1.0 + within(90.0, 1e3).abs();
    }
    plan
}

fn same(plan: &Plan, options: Options) {
    let program = program(&emit(plan, options).unwrap());
    let stops: Vec<_> = plan.rows.iter().filter(|row| !row.is_passed()).collect();
    for module in &program.modules[1..] {
        let data = module.data.as_ref().unwrap();
        assert_eq!(plan_hash(data).as_deref(), Some(plan.header.hash.as_str()));
        assert!(logged_axes(data).unwrap().is_empty());
    }
    // The points in the order of the rows; auxiliary points are part of their arcs.
    let mut rows = stops.iter().peekable();
    for (motion, through, to, sweep_deg) in program.modules[1..].iter().flat_map(motions) {
        let wanted = |row: &dbbd_job::plan::PlanRow| Target::Pose {
            xyz_mm: row.xyz_mm,
            abc_deg: row.abc_deg,
            status: Some(row.status.into()),
            turn: Some(row.turn.into()),
        };
        let row = rows.next().unwrap();
        match (motion, &to) {
            (MotionKind::Ptp, Target::Axes(_)) => assert_eq!(row.motion, MotionKind::Ptp),
            (MotionKind::Circ, _) => {
                assert_eq!(through, Some(wanted(row)));
                assert_eq!(to, wanted(rows.next().unwrap()));
                if let Some(sweep_deg) = sweep_deg {
                    let end = rows.next().unwrap().index;
                    let pass = plan.header.passes.iter().find(|pass| pass.end == end).unwrap();
                    assert!((pass.sweep_deg - sweep_deg).abs() < 1e-4);
                }
            }
            _ => {
                assert_eq!(motion, row.motion);
                assert_eq!(to, wanted(row));
            }
        }
    }
    assert!(rows.next().is_none());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    /// Emitted programs read back as the plan, to the printed digits.
    #[test]
    fn any_plan_reads_back(seed in any::<u64>()) {
        let plan = random_plan(seed);
        let server = std::net::SocketAddrV4::new([10, 0, 0, 1].into(), 54600);
        for (sync, controller) in [
            (Sync::Output, Controller::Krc2),
            (Sync::Marker, Controller::Krc4),
            (Sync::Ekrl { server }, Controller::Krc5),
        ] {
            same(&plan, Options { sync, controller });
        }
    }

    /// Unknown statements are preserved byte for byte and change no point.
    #[test]
    fn unknown_statements_are_preserved(lines in proptest::collection::vec("ZZ[A-Z_]{0,6}[ -~]{0,40}", 0..12), seed in 0u64..20) {
        // A statement that calls the program itself would be a recursion, which is not followed: no random text has this name.
        let bare = "DEF STATEMENTS ( )\r\n$TOOL={X 10.0,Y 0.0,Z 100.0,A 0.0,B 0.0,C 0.0}\r\n$BASE=$NULLFRAME\r\n\
                    PTP {A1 5.0,A2 -80.0,A3 100.0,A4 3.0,A5 60.0,A6 4.0}\r\n\
                    LIN {X 1300.0,Y 20.0,Z 900.0,A 3.0,B 20.0,C 180.0} C_DIS\r\n\
                    SLIN {X 1310.0,Y -20.0,Z 880.0,A 3.0,B 20.0,C 180.0} WITH $VEL={CP 0.1,ORI1 100.0,ORI2 100.0}\r\nEND\r\n";
        let places: Vec<usize> = bare.match_indices("\r\n").map(|(at, _)| at + 2).collect();
        let mut random = Pcg64::seed_from_u64(seed);
        let mut inserted: Vec<(usize, &String)> =
            lines.iter().map(|line| (places[random.random_range(0..places.len() - 1)], line)).collect();
        inserted.sort_by_key(|(at, _)| *at);
        let with = |text: &str, places: &[usize]| {
            let mut out = text.to_owned();
            for (at, line) in inserted.iter().rev() {
                let which = bare.match_indices("\r\n").position(|(end, _)| end + 2 == *at).unwrap();
                out.insert_str(places[which], &format!("{line}\r\n"));
            }
            out
        };
        let robot = Robot { nominal: Some(Box::new(kr60())), ..truth::draw_true_robot(&kr60(), 1, 1.0) };
        let corrected = |text: &str| {
            let files = Files { source: Text { file: "P.src", text }, data: None, config: None };
            let points = read(files, Given::default()).unwrap();
            compensate(files, &points, Correction::of(&robot, 20.0)).unwrap().source
        };
        let plain = corrected(bare);
        let ends: Vec<usize> = plain.match_indices("\r\n").map(|(at, _)| at + 2).collect();
        prop_assert_eq!(corrected(&with(bare, &places)), with(&plain, &ends));
    }
}

#[test]
fn dat_without_a_plan_has_no_hash() {
    let data = parse_data("P.dat", "DEFDAT P\nDECL INT N=1\nENDDAT\n").unwrap();
    assert_eq!(plan_hash(&data), None);
}
