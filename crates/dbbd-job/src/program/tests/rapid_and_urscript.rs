//! Programs in RAPID, URScript and of a FANUC: emitted programs read back, and run on the simulated controller with the stopping behaviour of its
//! maker.

use dbbd_job::plan::{Job, MotionKind, Plan, PlanRow, PoseKind as RowKind};
use dbbd_job::program::fanuc::{self, GivenFrames};
use dbbd_job::program::listing::{ActionKind, Standstill};
use dbbd_job::program::{Frames, Language, Listing, Sync, Target, Text, rapid, urscript};
use dbbd_job::sim::{ControllerMoment, SimulatedController};
use dbbd_model::robot::{ControllerModel, Geometry, Pose, Robot};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::frames_of_the_controller::elsewhere;
use crate::test_support::cell::named;
use crate::test_support::makes::{job, run};

const ALL: [(Language, &str, [f64; 3]); 4] = [
    (Language::Rapid, "irb1600-10-145", [900.0, 0.0, 850.0]),
    (Language::Urscript, "ur10", [700.0, 0.0, 300.0]),
    (Language::Fanuc, "m10id12", [900.0, 0.0, 300.0]),
    // CONFIG of this wrist is not known: positions are axis angles.
    (Language::Fanuc, "crx10ia", [650.0, -150.0, 200.0]),
];
/// A rotated tool, and a base frame.
const FRAMES: &str =
    "[motion]\ntool = [0.0, 0.0, 0.0, 30.0, 10.0, -20.0]\nbase = [100.0, -50.0, 20.0, 15.0, 0.0, 5.0]\n";

fn plan_of((_, name, centre): (Language, &str, [f64; 3]), more: &str) -> Plan {
    plan_for(&robot(name), name, centre, more)
}

fn plan_for(robot: &Robot, name: &str, centre: [f64; 3], more: &str) -> Plan {
    let text = format!("{}{more}", job(name, centre, 8));
    Plan::build(&Job::from_toml("job.toml", &text).unwrap(), robot).unwrap()
}

/// The simulated controller computes with the table of the file.
fn robot(name: &str) -> Robot {
    Robot { controller_model: ControllerModel::Nominal, ..named(name) }
}

/// The program of the plan, read back.
fn listing(plan: &Plan, language: Language, sync: Sync) -> Listing {
    match language {
        Language::Rapid => {
            let mut files = rapid::emit(plan, sync).unwrap();
            files.retain(|(name, _)| name.ends_with(".mod"));
            rapid::open(files.remove(0), files).unwrap()
        }
        Language::Fanuc => {
            let mut files = fanuc::emit(plan, sync).unwrap();
            fanuc::open(files.remove(0), files).unwrap()
        }
        _ => urscript::open(urscript::emit(plan, sync).unwrap().remove(0)).unwrap(),
    }
}

/// The first and the last moment of each strobe that is longer than the pulse of a marker.
fn dwells(moments: &[ControllerMoment]) -> Vec<[ControllerMoment; 2]> {
    let highs = moments.chunk_by(|a, b| a.strobe == b.strobe).filter(|chunk| chunk[0].strobe);
    let ends = highs.map(|chunk| [chunk[0], chunk[chunk.len() - 1]]);
    ends.filter(|[first, last]| last.t_s - first.t_s > 0.5).collect()
}

fn plans() -> [(Language, Robot, Plan); 9] {
    let [abb, ur, fanuc, crx] = ALL;
    let standing = |(language, name, centre): (Language, &'static str, [f64; 3]), more: &str| {
        let robot = elsewhere(robot(name));
        let plan = plan_for(&robot, name, centre, more);
        (language, robot, plan)
    };
    let of =
        |cell: (Language, &'static str, [f64; 3]), more: &str| (cell.0, robot(cell.1), plan_of(cell, more));
    [
        of(abb, ""),
        of(abb, FRAMES),
        of(ur, ""),
        of(fanuc, ""),
        of(fanuc, FRAMES),
        of(crx, ""),
        standing(abb, FRAMES),
        standing(ur, ""),
        standing(fanuc, FRAMES),
    ]
}

/// The tool point of a target in the robot base.
fn commanded(target: &Target, frames: &Frames, robot: &Robot) -> Pose {
    let frames = frames.for_table(&robot.frames);
    match *target {
        Target::Axes(axes_deg) => robot.geometry.ball(&axes_deg.map(f64::to_radians)),
        Target::Pose { xyz_mm, abc_deg, .. } => {
            let tool = frames.base.then(&Pose::from_kuka(xyz_mm, abc_deg));
            Pose { rotation: tool.rotation * frames.tool.rotation.transpose(), position: tool.position }
        }
    }
}

#[test]
fn points_read_back_to_a_micrometre() {
    for (language, robot, plan) in plans() {
        let listing = listing(&plan, language, Sync::Output);
        let moves = listing.actions.iter().filter_map(|action| match &action.kind {
            ActionKind::Move(motion) => Some(motion),
            _ => None,
        });
        // The first motion is to the start; auxiliary points are not motions.
        let rows: Vec<&PlanRow> = plan.rows.iter().filter(|row| !row.is_auxiliary()).collect();
        let moves: Vec<_> = moves.collect();
        assert_eq!(moves.len(), rows.len(), "{language:?}");
        for (motion, row) in moves.iter().zip(&rows) {
            let (is, wanted) =
                (commanded(&motion.to, &motion.frames, &robot), Pose::from_kuka(row.xyz_mm, row.abc_deg));
            let (off_mm, turn) = ((is.position - wanted.position).norm(), is.angle_to(&wanted));
            // A listing has three decimals: 0.0005 mm for a pose, 0.0005 degrees of an angle at a lever of up to a metre each.
            let (max_mm, most) = match (language, &motion.to) {
                (Language::Fanuc, Target::Pose { .. }) => (1e-3, 3e-5),
                (Language::Fanuc, Target::Axes(_)) => (0.04, 6e-5),
                _ => (1e-3, 1e-6),
            };
            assert!(
                off_mm < max_mm && turn < most,
                "{language:?} row {}: {off_mm} mm, {turn} rad",
                row.index
            );
        }
        assert_eq!(listing.setups.len(), 1);
        assert_eq!(listing.setups[0].centre_mm, plan.header.job.centres[0].xyz_mm);
        assert_eq!(listing.setups[0].length_mm, 300.0);
    }
}

#[test]
fn strobes_are_at_their_poses() {
    for (language, robot, plan) in plans() {
        let moments = run(listing(&plan, language, Sync::Output), &robot);
        let rows: Vec<_> = plan.rows.iter().filter(|row| row.kind != RowKind::Transit).collect();
        let dwells = dwells(&moments);
        assert_eq!(dwells.len(), rows.len(), "{language:?}");
        for ([first, last], row) in dwells.iter().zip(&rows) {
            // The remaining lag after the settling time: two micrometres of more than a millimetre.
            let rounded_mm = if robot.name.contains("CRX") { 0.04 } else { 0.0 };
            for (moment, max_mm) in [(first, 0.02 + rounded_mm), (last, 1e-3 + rounded_mm)] {
                let off = robot.geometry.ball(&moment.axes).position - Vector3::from(row.xyz_mm);
                assert!(off.norm() < max_mm, "{language:?} row {}: {} mm", row.index, off.norm());
            }
        }
        // Markers: 3 pulses at the start and 2 at the end.
        let highs = moments.chunk_by(|a, b| a.strobe == b.strobe).filter(|chunk| chunk[0].strobe).count();
        assert_eq!(highs, dwells.len() + 5, "{language:?}");
        // Without outputs there is no strobe, and the motions are the same.
        let silent = run(listing(&plan, language, Sync::Marker), &robot);
        assert!(silent.iter().all(|moment| !moment.strobe));
        assert_eq!(silent.last().unwrap().motions, moments.last().unwrap().motions);
    }
}

/// ABB's `tool0` at zero angles and UR's flange by the figures of the makers: IRB 120 (374, 0, 630) with the quaternion
/// (0.7071, 0, 0.7071, 0): z forward, x down; UR10 (a2 + a3, -d4 - d6, d1 - d5).
#[test]
fn flange_frames_agree_with_the_makers() {
    let flange = |name: &str| {
        let geometry = Geometry { tool: Vector3::zeros(), ..named(name).geometry };
        geometry.ball(&[0.0; 6])
    };
    let abb = flange("irb120");
    assert!((abb.position - Vector3::new(374.0, 0.0, 630.0)).norm() < 1e-9, "{}", abb.position);
    let half = 0.5_f64.sqrt();
    let off: f64 =
        abb.quaternion().iter().zip([half, 0.0, half, 0.0]).map(|(is, wanted)| (is - wanted).abs()).sum();
    assert!(off < 1e-9, "{:?}", abb.quaternion());
    let ur = flange("ur10");
    assert!((ur.position - Vector3::new(-1184.3, -256.141, 11.6)).norm() < 1e-9, "{}", ur.position);
}

/// Programs that cannot be executed, with their code.
const REFUSED: &[(&str, &str, &str)] = &[
    ("M.mod", "MODULE M\nPROC M()\nENDPROC\nENDMODULE\n", "E0884"),
    ("M.mod", "MODULE M\nENDMODULE\n", "E0806"),
    ("M.mod", "MODULE M\nPROC main()\nIF TRUE THEN\nENDIF\nENDPROC\nENDMODULE\n", "E0804"),
    ("M.mod", "MODULE M\nPROC main()\nGripLoad x;\nENDPROC\nENDMODULE\n", "E0804"),
    ("M.mod", "MODULE M\nPROC main()\nmain;\nENDPROC\nENDMODULE\n", "E0805"),
    (
        "M.mod",
        "MODULE M\nPROC main()\nMoveAbsJ [[0,0,0,0,30,0],[]],v100,z10,tool0;\nENDPROC\nENDMODULE\n",
        "E0804",
    ),
    (
        "M.mod",
        "MODULE M\nPROC main()\nMoveL [[900,0,900],[0,0,1,0],[0,0,0,0],[]],v100,fine,tool0;\nENDPROC\nENDMODULE\n",
        "E0814",
    ),
    ("M.ls", "/PROG M\n/MN\n1: J P[1] 5% FINE ;\n", "E0980"),
    ("M.ls", "/PROG M\n/MN\n1: IF R[1]=1,JMP LBL[1] ;\n/POS\n/END\n", "E0804"),
    ("M.ls", "/PROG M\n/MN\n1: CALL OTHER ;\n/POS\n/END\n", "E0804"),
    ("M.ls", "/PROG M\n/MN\n1: CALL M ;\n/POS\n/END\n", "E0805"),
    ("M.ls", "/PROG M\n/MN\n1: J P[1] 5% FINE ;\n/POS\n/END\n", "E0808"),
    ("M.script", "end\n", "E0803"),
    ("M.script", "def p():\n  movel(p[0.5,0.1,0.5,0,3.1,0], r=0.01)\nend\n", "E0804"),
    ("M.script", "def p():\n  if True:\n  end\nend\n", "E0804"),
    ("M.script", "def p():\n  movej([0,0,0,0,0,9.9])\nend\n", "E0813"),
];

#[test]
fn unsupported_programs_are_refused() {
    let robots = [named("irb1600-10-145"), named("ur10"), named("m10id12")];
    for (name, text, code) in REFUSED {
        let file = ((*name).to_owned(), (*text).to_owned());
        let (robot, opened) = match name.rsplit_once('.').unwrap().1 {
            "mod" => (0, rapid::open(file, vec![])),
            "script" => (1, urscript::open(file)),
            _ => (2, fanuc::open(file, vec![])),
        };
        let found = opened.and_then(|listing| {
            SimulatedController::new(listing, &robots[robot], 100.0)
                .and_then(|mut machine| machine.step(30.0))
        });
        assert_eq!(found.unwrap_err().code().as_str(), *code, "{text}");
    }
}

/// A program with any byte changed is read or refused, without a panic; a short sample of the campaign.
#[test]
fn no_program_text_makes_the_parsers_panic() {
    let texts = [
        (Language::Rapid, rapid::emit(&plan_of(ALL[0], ""), Sync::Output).unwrap().remove(2).1),
        (Language::Urscript, urscript::emit(&plan_of(ALL[1], ""), Sync::Output).unwrap().remove(0).1),
        (Language::Fanuc, fanuc::emit(&plan_of(ALL[2], ""), Sync::Output).unwrap().remove(1).1),
    ];
    let mut random = Pcg64::seed_from_u64(5);
    let (mut read, mut refused) = (0, 0);
    for (language, text) in texts {
        for _ in 0..60 {
            let mut bytes = text.clone().into_bytes();
            for _ in 0..random.random_range(1..4) {
                let at = random.random_range(0..bytes.len());
                bytes[at] = b"[](){}\"\\;:=,.-!#\nEp9"[random.random_range(0..20)];
            }
            if random.random_range(0..2) == 0 {
                bytes.truncate(random.random_range(bytes.len() / 2..=bytes.len()));
            }
            let text = String::from_utf8_lossy(&bytes).into_owned();
            let points = match language {
                Language::Rapid => rapid::read(Text { file: "P", text: &text }, None),
                Language::Fanuc => fanuc::read(Text { file: "P", text: &text }, GivenFrames::default()),
                _ => urscript::read(Text { file: "P", text: &text }, None),
            };
            let opened = match language {
                Language::Rapid => rapid::open(("P".into(), text.clone()), vec![]),
                Language::Fanuc => fanuc::open(("P".into(), text.clone()), vec![]),
                _ => urscript::open(("P".into(), text.clone())),
            };
            read += usize::from(points.is_ok());
            refused += usize::from(opened.is_err());
        }
    }
    assert!(read > 0 && refused > 0, "{read} {refused}");
}

/// In every language a dwell begins at standstill after the settling time.
#[test]
fn dwells_wait_for_standstill() {
    for (language, _, plan) in plans() {
        let listing = listing(&plan, language, Sync::Output);
        let actions: Vec<&ActionKind> = listing.actions.iter().map(|action| &action.kind).collect();
        let dwell =
            |at: usize| matches!(actions.get(at + 1), Some(ActionKind::Wait(seconds)) if *seconds > 0.5);
        let rises =
            (0..actions.len()).filter(|at| matches!(actions[*at], ActionKind::SetStrobe(true)) && dwell(*at));
        let mut seen = 0;
        for at in rises {
            // FINE of a FANUC ends in position.
            let is_still = match (language, actions[at - 1], actions[at - 2]) {
                (Language::Fanuc, ActionKind::Wait(_), ActionKind::Move(motion)) => motion.ends_in_position,
                (_, before, _) => matches!(before, ActionKind::WaitForStandstill(Standstill::ZeroSpeed)),
            };
            assert!(is_still, "{language:?}");
            seen += 1;
        }
        let dwells = plan.rows.iter().filter(|row| row.kind != RowKind::Transit).count();
        assert_eq!(seen, dwells, "{language:?}");
        assert!(plan.rows.iter().any(|row| row.motion == MotionKind::Circ));
    }
}

/// A FANUC is in position at the start of a program, at dwells and at both ends of sync markers (1 mm/s). At the transits between chosen poses it
/// does not wait: in the simulator each wait takes a quarter of a second.
#[test]
fn fanuc_is_in_position_where_it_rests() {
    let (_, name, centre) = ALL[2];
    let text = job(name, centre, 8);
    let text =
        format!("{}[optimise]\npoints = 12\ncandidates = 200\n", text.split("[[circle]]").next().unwrap());
    let plan = Plan::build(&Job::from_toml("job.toml", &text).unwrap(), &robot(name)).unwrap();
    let listing = listing(&plan, Language::Fanuc, Sync::Marker);
    let waits = listing.actions.iter().filter_map(|action| match &action.kind {
        ActionKind::Move(motion) => Some(motion.ends_in_position),
        _ => None,
    });
    let [rests, goes_on]: [Vec<bool>; 2] = waits.partition(|waits| *waits).into();
    let dwells = plan.rows.iter().filter(|row| row.kind != RowKind::Transit).count();
    let markers = plan.header.moves.iter().filter(|time| time.feed_mm_s == 1.0).count();
    assert_eq!((rests.len(), markers), (1 + dwells + markers, 10));
    assert!(goes_on.len() > dwells, "{}", goes_on.len());
}

/// Blocks are nested as deep as a file can be long, in a time that grows with its length.
#[test]
fn blocks_of_a_script_are_nested_deep() {
    const DEEP: usize = 100_000;
    let text = format!(
        "def p():\n{}movej([0, -1, 1, 0, 1, 0])\n{}end\n",
        "if n > 0:\n".repeat(DEEP),
        "end\n".repeat(DEEP)
    );
    let read = |text: &str| urscript::read(Text { file: "p.script", text }, None).map(drop);
    assert_eq!(read(&text), Ok(()));
    let unclosed = text.replacen("end\n", "", 1);
    assert_eq!(read(&unclosed).unwrap_err().code().as_str(), "E0803");
}
