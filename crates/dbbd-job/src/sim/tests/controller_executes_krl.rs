//! The simulated controller executes KRL: it reaches the programmed poses, is at rest while the strobe is high, and stops with the
//! line of a statement that it cannot execute.

use dbbd_job::plan::{PlanRow, PoseKind as RowKind};
use dbbd_job::program::krl::{Controller as Kind, Options, Program, Sync, emit};
use dbbd_job::sim::world::WorldSetup;
use dbbd_job::sim::{ControllerMoment, SimulatedController, World, truth};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::{Geometry, Pose};

use crate::test_support::circle_plan::{BAR_MM, plan, robot};
use crate::test_support::krl;

const DT_S: f64 = 0.002;

/// Runs to the end; HALT ends at once.
fn run(mut controller: SimulatedController) -> Result<Vec<ControllerMoment>, Diagnostic> {
    let mut moments = Vec::new();
    while moments.len() < 500_000 {
        let moment = controller.step(DT_S)?;
        moments.push(moment);
        if moment.halted {
            controller.go_on();
        }
        if moment.done {
            return Ok(moments);
        }
    }
    panic!("never ends")
}

/// A module T and its `.dat`.
fn program(source: &str, data: &str) -> Result<Program, Diagnostic> {
    Program::open("T", |wanted| {
        let text = match wanted {
            "T.src" => source,
            "T.dat" => data,
            _ => "",
        };
        Ok((!text.is_empty()).then(|| (wanted.to_owned(), text.to_owned())))
    })
}

fn small(body: &str) -> SimulatedController {
    let text = format!("DEF T ( )\nPTP {{A1 0.0,A2 -90.0,A3 90.0,A4 0.0,A5 45.0,A6 0.0}}\n{body}\nEND\n");
    SimulatedController::new(program(&text, "").unwrap(), &robot(), 100.0).unwrap()
}

/// The first and the last moment of each strobe that is longer than the pulse of a marker.
fn dwells(moments: &[ControllerMoment]) -> Vec<(ControllerMoment, ControllerMoment)> {
    let highs = moments.chunk_by(|a, b| a.strobe == b.strobe).filter(|chunk| chunk[0].strobe);
    let ends = highs.map(|chunk| (chunk[0], chunk[chunk.len() - 1]));
    ends.filter(|(first, last)| last.t_s - first.t_s > 0.5).collect()
}

fn pose_error(geometry: &Geometry, moment: &ControllerMoment, row: &PlanRow) -> (f64, f64) {
    let (is, wanted) = (geometry.ball(&moment.axes), Pose::from_kuka(row.xyz_mm, row.abc_deg));
    ((is.position - wanted.position).norm(), (is.rotation - wanted.rotation).norm())
}

#[test]
fn strobes_are_at_their_poses() {
    let plan = plan(2, 8);
    let files = emit(&plan, Options { sync: Sync::Output, controller: Kind::Krc4 }).unwrap();
    let program = krl::program(&files);
    let setup = WorldSetup::new(&program.setups(), Some(("W", "[bar]\nnoise_um = 0.0\nresolution_um = 0.0")))
        .unwrap();
    let robot = robot();
    let moments = run(SimulatedController::new(program, &robot, 100.0).unwrap()).unwrap();
    let rows: Vec<_> = plan.rows.iter().filter(|row| row.kind != RowKind::Transit).collect();
    let dwells = dwells(&moments);
    assert_eq!(dwells.len(), rows.len());
    for ((first, last), row) in dwells.iter().zip(&rows) {
        for moment in [first, last] {
            let (distance_mm, turn) = pose_error(&robot.geometry, moment, row);
            assert!(distance_mm < 1e-6 && turn < 1e-9, "row {}: {distance_mm} mm, {turn}", row.index);
        }
        assert!((last.t_s - first.t_s - row.dwell_s).abs() < 2.0 * DT_S);
    }
    // Markers: 3 pulses at the start of each module and 2 at its end.
    let highs = moments.chunk_by(|a, b| a.strobe == b.strobe).filter(|chunk| chunk[0].strobe).count();
    assert_eq!(highs, dwells.len() + 2 * (3 + 2));
    // If the true robot is the nominal one and the ball is where the plan has it, the bar reads the lengths of the plan, up to the
    // rounding of the poses (half a micrometre in each coordinate).
    let mut world = World::new(robot.geometry, setup, 1);
    for moment in &moments {
        let measured = world.reading(moment);
        if let Some(at) = dwells.iter().position(|(first, last)| first == moment || last == moment) {
            assert!(measured.in_stroke);
            assert!((measured.reading_mm + BAR_MM - rows[at].length_mm).abs() < 1e-3);
        }
    }
}

#[test]
fn arcs_keep_their_radius_and_lines_their_direction() {
    let mut controller = small(
        "$VEL.CP=0.1\n$ACC.CP=0.5\nPTP {X 1500.0,Y 0.0,Z 900.0,A 0.0,B 90.0,C 0.0}\n\
         CIRC {X 1400.0,Y 100.0,Z 900.0},{X 1300.0,Y 0.0,Z 900.0,A 0.0,B 90.0,C 0.0}\n\
         CIRC {X 1400.0,Y -100.0,Z 900.0},{X 1500.0,Y 0.0,Z 900.0},CA -90.0\nHALT",
    );
    let geometry = Geometry { tool: nalgebra::Vector3::zeros(), ..robot().geometry };
    let mut seen = Vec::new();
    loop {
        let moment = controller.step(0.01).unwrap();
        if moment.motions >= 3 {
            seen.push((moment.t_s, geometry.ball(&moment.axes).position));
        }
        if moment.halted {
            break;
        }
    }
    for (_, p) in &seen {
        assert!(((p - nalgebra::Vector3::new(1400.0, 0.0, 900.0)).norm() - 100.0).abs() < 1e-6);
    }
    // CA -90: a quarter circle against the taught direction, from (1300, 0) back to (1400, 100).
    let end = seen.last().unwrap().1;
    assert!((end - nalgebra::Vector3::new(1400.0, 100.0, 900.0)).norm() < 1e-6, "{end}");
    // A trapezoidal profile over d takes d/v + v/a: here over pi 100 mm and pi 50 mm.
    let expected_s = std::f64::consts::PI * 1.5 + 2.0 * 0.1 / 0.5;
    assert!((seen.last().unwrap().0 - seen[0].0 - expected_s).abs() < 0.03);
}

#[test]
fn override_slows_motions_but_not_waits() {
    let end_s = |percent: f64| {
        let program = program("DEF T ( )\nPTP {A1 20.0}\nWAIT SEC 1.0\nEND\n", "").unwrap();
        let controller = SimulatedController::new(program, &robot(), percent).unwrap();
        run(controller).unwrap().last().unwrap().t_s
    };
    // 20 deg at 128 deg/s and 320 deg/s^2: a triangle of 2 sqrt(20/320) = 0.5 s.
    assert!((end_s(100.0) - 1.5).abs() < 2.0 * DT_S);
    assert!((end_s(50.0) - 2.0).abs() < 2.0 * DT_S);
}

#[test]
fn loops_calls_signals_and_pulses_run() {
    let text = "DEF T ( )\nPTP {A1 0.0}\nFOR K=1 TO 3 STEP 1\nSUB (K,0.5)\nENDFOR\nWHILE K>0\nK=K-2\nENDWHILE\nLOOP\nEXIT\nENDLOOP\n\
                IF K==0 THEN\nDBBSTB=TRUE\nENDIF\nWAIT SEC 0.1\nDBBSTB=FALSE\nPULSE ($OUT[1],TRUE,0.2)\nWAIT SEC 1\n\
                WAIT FOR IDX==3\nEND\nDEF SUB (N :IN,W :IN )\nINT N\nREAL W\nIDX=N\nQ[N]=$AXIS_ACT_MEAS\nWAIT SEC W\nEND\n";
    let data = "DEFDAT T\nINT K=0\nSIGNAL DBBSTB $OUT[1]\nSIGNAL IDX $OUT[9] TO $OUT[16]\nDECL E6AXIS Q[3]\nENDDAT\n";
    let program = program(text, data).unwrap();
    let moments = run(SimulatedController::new(program, &robot(), 100.0).unwrap()).unwrap();
    let highs: Vec<f64> = moments
        .chunk_by(|a, b| a.strobe == b.strobe)
        .filter(|chunk| chunk[0].strobe)
        .map(|chunk| chunk.len() as f64 * DT_S)
        .collect();
    // K is 4 after the loop and 0 after the next: the first strobe is that of the assignment, the second one the pulse, and between
    // them are only the end of one and the start of the other.
    assert_eq!(highs.len(), 1);
    assert!((highs[0] - 0.3).abs() < 3.0 * DT_S, "{highs:?}");
}

/// Statements in line 3 or 4 of a program at which the controller stops, with code, line and column.
const STOPS: &[(&str, &str, usize, usize)] = &[
    ("PTP {A2 40.0}", "E0813", 3, 1),
    ("$VEL.CP=0.1\nLIN {X 5000.0}", "E0813", 4, 1),
    ("CIRC {X 1300.0},{X 1200.0}", "E0813", 3, 1),
    ("PTP {X 1300.0,Y 0.0,Z 900.0,A 0.0,B 180.0,C 0.0,S 2,T 63}", "E0813", 3, 5),
    ("PTP {X 1300.0,Y 0.0,Z 900.0,A 0.0,B 180.0,C 0.0,S 2,T 999}", "E0813", 3, 5),
    ("$VEL.CP=250.0\nLIN {Z 1700.0}", "E0814", 4, 1),
    ("$VEL.CP=0.0\nLIN {Z 1700.0}", "E0814", 4, 1),
    ("LIN {X 1300.0} C_DIS", "E0804", 3, 1),
    ("$ORI_TYPE=#JOINT\nLIN {Z 1700.0}", "E0804", 4, 1),
    ("BAS (#TOOL,3)", "E0804", 3, 1),
    ("BAS (#VEL_PTP)", "E0817", 3, 1),
    ("BAS (#VEL_PTP,200)", "E0816", 3, 15),
    ("A=1", "E0811", 3, 1),
    ("$TOOLS=1", "E0811", 3, 1),
    ("NOWHERE=$OUT[9999]", "E0810", 3, 9),
    ("$VEL.CP=TRUE", "E0810", 3, 1),
    ("$TOOL.Q=1.0", "E0810", 3, 1),
    ("$OUT=TRUE", "E0810", 3, 1),
    ("LIN 5", "E0808", 3, 5),
    ("$VEL.CP=1/0", "E0812", 3, 9),
    ("$VEL.CP=1.0/0", "E0812", 3, 9),
    ("$VEL.CP=1.0E300*1.0E300", "E0812", 3, 9),
    ("$ADVANCE=-('H80000000'+0)", "E0812", 3, 10),
    ("$ADVANCE=2147483647+1", "E0812", 3, 10),
    ("LOOP\n$OV_PRO=100\nENDLOOP", "E0815", 4, 1),
    ("LOOP\nWAIT SEC 0\nENDLOOP", "E0815", 4, 1),
    ("LOOP\nWAIT FOR TRUE\nENDLOOP", "E0815", 4, 1),
    ("EXIT", "E0815", 3, 1),
    ("FOR $ADVANCE=1 TO 2 STEP 0\nENDFOR", "E0815", 3, 1),
    ("$AXIS_ACT.A1=3.0", "E0816", 3, 1),
    ("$OV_PRO=101", "E0816", 3, 1),
    ("PULSE ($OUT[1],TRUE,5.0)", "E0816", 3, 8),
    ("PULSE ($IN[1],TRUE,0.5)", "E0816", 3, 8),
    ("$VEL.CP=EKI_Open (\"X\")", "E0818", 3, 9),
    ("T ( )", "E0805", 2, 1),
];

/// Lines of a `.dat` that the controller does not load.
const DATA: &[(&str, &str)] = &[
    ("DECL MYTYPE A", "E0811"),
    ("DECL INT A\nDECL INT A", "E0811"),
    ("SIGNAL S $OUT[1] TO $OUT[99]", "E0816"),
    ("SIGNAL S $FLAG[1]", "E0816"),
    ("DECL INT A=B", "E0811"),
];

#[test]
fn impossible_statements_stop_with_their_line() {
    for (body, code, line, column) in STOPS {
        let stop = run(small(body)).expect_err(body);
        // A routine that calls itself stops at its first motion, whose line is 2.
        assert_eq!((stop.code().as_str(), stop.file_name()), (*code, "T.src"), "{body}: {stop}");
        assert!(
            *code == "E0805" || (stop.line_number(), stop.column_number()) == (*line, *column),
            "{body}: {stop}"
        );
    }
    for (line, code) in DATA {
        let data = format!("DEFDAT T\n{line}\nENDDAT\n");
        let program = program("DEF T ( )\nEND\n", &data).unwrap();
        assert_eq!(
            SimulatedController::new(program, &robot(), 100.0).unwrap_err().code().as_str(),
            *code,
            "{line}"
        );
    }
    let first = program("DEF T ( )\nLIN {X 1300.0}\nEND\n", "").unwrap();
    let stop = run(SimulatedController::new(first, &robot(), 100.0).unwrap()).unwrap_err();
    assert_eq!((stop.code().as_str(), stop.line_number(), stop.column_number()), ("E0814", 2, 1));
    let missing = program("DEF T ( )\nOTHER (1)\nEND\n", "").unwrap_err();
    assert_eq!((missing.code().as_str(), missing.line_number(), missing.column_number()), ("E0806", 2, 1));
    let arguments = program("DEF T ( )\nSUB (1)\nEND\nDEF SUB ( )\nEND\n", "").unwrap();
    let stop = run(SimulatedController::new(arguments, &robot(), 100.0).unwrap()).unwrap_err();
    assert_eq!((stop.code().as_str(), stop.line_number()), ("E0817", 2));
}

/// Wrong WORLD.toml files.
const WORLDS: &[(&str, &str)] = &[
    ("[bar]\nnoise = 1.0", "E0120"),
    ("[[centre]]\nid = 1\nxyz_mm = [1, 0, 0]\n[[centre]]\nid = 1\nxyz_mm = [1, 0, 0]", "E1602"),
    ("[[centre]]\nid = 1", "E1602"),
    ("[bar]\nnoise_um = -1.0", "E0130"),
    ("[bar]\nrate_hz = 0.0", "E0130"),
    ("[bar]\nstroke_mm = [1.0, -1.0]", "E1603"),
    ("backlash_deg = [0, 0, 0, 0, 0, -1]", "E0130"),
];

#[test]
fn world_file_is_read() {
    let files = emit(&plan(1, 3), Options { sync: Sync::Output, controller: Kind::Krc4 }).unwrap();
    let program = krl::program(&files);
    for (text, code) in WORLDS {
        let wrong = WorldSetup::new(&program.setups(), Some(("W.toml", text))).unwrap_err();
        assert_eq!((wrong.code().as_str(), wrong.file_name()), (*code, "W.toml"), "{text}");
    }
    let bare = self::program("DEF T ( )\nEND\n", "").unwrap();
    assert_eq!(WorldSetup::new(&bare.setups(), None).unwrap_err().code().as_str(), "E1602");
    let text = "repeatability_um = 20.0\n[bar]\nlength_mm = 299.5\nresolution_um = 10.0\nnoise_um = 0.0\n\
                [[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]";
    let setup = WorldSetup::new(&program.setups(), Some(("W.toml", text))).unwrap();
    let robot = robot();
    let still = |motions: u32| ControllerMoment {
        // The error of each motion has replaced the one before.
        t_s: f64::from(motions),
        axes: plan(1, 3).rows[0].axes_deg.map(f64::to_radians),
        centre: 1,
        strobe: false,
        motions,
        halted: false,
        done: false,
    };
    let mut world = World::new(robot.geometry.clone(), setup.clone(), 7);
    let mut again = World::new(robot.geometry.clone(), setup, 7);
    let readings: Vec<f64> = (0..2000).map(|motions| world.reading(&still(motions)).reading_mm).collect();
    assert_eq!(
        readings,
        (0..2000).map(|motions| again.reading(&still(motions)).reading_mm).collect::<Vec<_>>()
    );
    let mean = readings.iter().sum::<f64>() / 2000.0;
    let sd = (readings.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / 1999.0).sqrt();
    // 20 um along the bar, with 10 um / sqrt 12 of rounding; standard errors 0.45 and 0.33 um.
    assert!((mean - 0.5).abs() < 2e-3 && (sd - 20.2e-3).abs() < 1.5e-3, "{mean} {sd}");
    assert!(readings.iter().all(|r| (r * 100.0 - (r * 100.0).round()).abs() < 1e-9));
    let one = world.reading(&still(3)).reading_mm;
    assert_eq!(one, world.reading(&still(3)).reading_mm, "the offset is drawn once for each motion");
    let mut far = still(0);
    far.axes[0] += 0.1;
    assert!(!world.reading(&far).in_stroke);
}

#[test]
fn true_robot_is_drawn_from_the_tolerance() {
    let nominal = robot();
    assert_eq!(
        truth::draw_true_robot(&nominal, 3, 1.0).geometry,
        truth::draw_true_robot(&nominal, 3, 1.0).geometry
    );
    assert_eq!(truth::draw_true_robot(&nominal, 3, 0.0).geometry, nominal.geometry);
    let (mut sum, mut count) = (0.0, 0.0);
    for seed in 0..200 {
        let robot = truth::draw_true_robot(&nominal, seed, 2.0);
        for (row, from) in robot.geometry.rows.iter().zip(&nominal.geometry.rows) {
            sum += ((row.a - from.a) / (2.0 * nominal.tolerance.length_mm)).powi(2);
            sum += ((row.alpha - from.alpha) / (2.0 * nominal.tolerance.angle_deg.to_radians())).powi(2);
            count += 2.0;
        }
        assert_eq!(robot.geometry.rows[2].d, 0.0); // axes 2 and 3 are parallel
        assert_ne!(robot.geometry.rows[2].beta, 0.0);
    }
    // Mean square of 2400 standard normals: 1 with standard error sqrt(2/2400) = 0.029.
    assert!((sum / count - 1.0_f64).abs() < 0.12, "{}", sum / count);
}
