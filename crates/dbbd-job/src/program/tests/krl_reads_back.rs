//! Emitted KRL reads back as the plan, and unsupported KRL is refused with its place.

use dbbd_job::plan::{MotionKind, Plan, PoseKind};
use dbbd_job::program::Target;
use dbbd_job::program::krl::syntax::Source;
use dbbd_job::program::krl::{
    Controller, Files, Given, Options, Sync, Text, emit, logged_axes, parse_data, parse_source, read,
    read_setup,
};
use proptest::prelude::*;

use crate::test_support::circle_plan::{BALL_MM, BAR_MM, plan};
use crate::test_support::krl::{motions, program};

const ALL: [(Sync, Controller); 4] = [
    (Sync::Output, Controller::Krc4),
    (Sync::Marker, Controller::Krc4),
    (Sync::Output, Controller::Krc2),
    (Sync::Marker, Controller::Krc5),
];

fn modules(plan: &Plan, sync: Sync, controller: Controller) -> Vec<(String, String)> {
    emit(plan, Options { sync, controller }).unwrap()
}

/// Code, line and column of the finding about a `.src`.
fn refused(text: &str) -> (&'static str, usize, usize) {
    let wrong = parse_source("T.src", text).unwrap_err();
    (wrong.code().as_str(), wrong.line_number(), wrong.column_number())
}

/// A `.src` that is not KRL or not supported, with its code, line and column.
const REFUSED: &[(&str, &str, usize, usize)] = &[
    ("DEF T ( )\r\n  ; a comment\r\n  SPLINE\r\nEND\r\n", "E0804", 3, 3),
    ("DEF T ( )\nA=SIN(1.0)\nEND\n", "E0804", 2, 3),
    ("DEF T (A :OUT)\nEND\n", "E0804", 1, 11),
    ("DEF T ( )\nWIAT SEC 1\nEND\n", "E0803", 2, 1),
    ("DEF T ( )\nLIN {X 1,5,Y 2.0}\nEND\n", "E0803", 2, 10), // a decimal comma
    ("DEF T ( )\nLIN {X 1.0,Y 2.0\nEND\n", "E0803", 2, 17),  // an open brace
    ("DEF T ( )\nLIN {X 1.0,X 2.0}\nEND\n", "E0803", 2, 12),
    ("DEF T ( )\nFOR K=1 TO 3\nHALT\nEND\n", "E0803", 4, 1), // no ENDFOR
    ("DEF T ( )\nHALT\n", "E0803", 3, 1),                    // no END
    ("DEF T ( )\nHALT\nINT N\nEND\n", "E0803", 3, 1),        // a declaration too late
    ("DEF T ( )\nPTP P1 C_FAST\nEND\n", "E0803", 2, 8),      // no approximation of that name
    ("DEF T ( )\n;FOLD A\nEND\n", "E0802", 2, 1),
    ("DEF T ( )\n;ENDFOLD\nEND\n", "E0802", 2, 1),
    ("DEF T ( )\nA=\u{fc}\nEND\n", "E0801", 2, 3),
    ("\u{feff}DEF T ( )\nEND\n", "E0801", 1, 1),
    ("DEF T ( )\nA=\"x\nEND\n", "E0801", 2, 3), // an open text
    ("DEF T ( )\nA='B2'\nEND\n", "E0801", 2, 3),
    ("DEF A_NAME_THAT_IS_FAR_TOO_LONG ( )\nEND\n", "E0801", 1, 5),
    ("DEF T ( )\nA=99999999999999999999\nEND\n", "E0801", 2, 3),
    ("DEF T ( )\nA=2147483649\nEND\n", "E0801", 2, 3),
    ("DEF T ( )\nA=-'H-8000000000000000'\nEND\n", "E0801", 2, 4),
    ("DEF T ( )\nDECL E6POS P[100000]\nEND\n", "E0803", 2, 14),
    ("", "E0806", 0, 0),
    ("DEF T ( )\nEND\nDEF T ( )\nEND\n", "E0806", 3, 5),
];

fn parsed(text: &str) -> Source {
    parse_source("T.src", text).unwrap()
}

#[test]
fn every_pose_reads_back_to_the_printed_digits() {
    let plan = plan(2, 8);
    for (sync, controller) in ALL {
        let program = program(&modules(&plan, sync, controller));
        assert_eq!(program.modules.len(), 3);
        let auxiliary = |kind, motion| kind == PoseKind::Transit && motion == MotionKind::Circ;
        let rows: Vec<_> = plan.rows.iter().filter(|row| !auxiliary(row.kind, row.motion)).collect();
        let read: Vec<_> = program.modules[1..].iter().flat_map(motions).collect();
        assert_eq!(read.len(), rows.len());
        for ((motion, through, to, _), row) in read.into_iter().zip(rows) {
            assert_eq!(motion, row.motion);
            match to {
                Target::Axes(axes) => {
                    assert_eq!(row.motion, MotionKind::Ptp);
                    for (read, planned) in axes.iter().zip(row.axes_deg) {
                        assert!((read - planned).abs() <= 0.5001e-4);
                    }
                }
                Target::Pose { xyz_mm, abc_deg, status, turn } => {
                    assert_eq!((xyz_mm, abc_deg), (row.xyz_mm, row.abc_deg));
                    assert_eq!((status, turn), (Some(row.status.into()), Some(row.turn.into())));
                }
            }
            if row.motion == MotionKind::Circ {
                let planned = &plan.rows[row.index as usize - 2];
                let Some(Target::Pose { xyz_mm, .. }) = through else { panic!("no auxiliary point") };
                assert_eq!(xyz_mm, planned.xyz_mm);
            }
        }
        let setup = read_setup(program.modules[1].data.as_ref().unwrap()).unwrap();
        assert_eq!((setup.ball, setup.centre_mm, setup.length_mm), (1, BALL_MM, BAR_MM));
        assert_eq!(setup.stroke_mm, [-1.0, 1.0]);
    }
}

#[test]
fn files_have_the_format_that_controllers_load() {
    let plan = plan(2, 8);
    for (sync, controller) in ALL {
        for (name, text) in modules(&plan, sync, controller) {
            let stem = name.split('.').next().unwrap();
            assert!(
                stem.len() <= 16
                    && text
                        .contains(&format!("DEF{} {stem}", if name.ends_with("dat") { "DAT" } else { "" }))
            );
            assert!(text.is_ascii() && text.ends_with("\r\n"));
            assert_eq!(text.matches('\n').count(), text.matches("\r\n").count());
            assert!(text.contains("0123456789abcdef"), "{name} does not name its plan");
            for line in text.lines() {
                assert!(line.len() < 200, "{line}");
                assert!(
                    !line.contains("-0.000,") && !line.contains("-0.0000,") && !line.contains("NaN"),
                    "{line}"
                );
                // All 14 components of an E6POS.
                assert!(!line.starts_with("XP[") || line.matches(' ').count() == 14, "{line}");
            }
            assert!(controller == Controller::Krc2 || !text.contains("EXT "), "{name}");
            if controller == Controller::Krc2 && name.ends_with(".dat") {
                assert!(text.contains("EXT BAS (BAS_COMMAND :IN,REAL :IN )"));
            }
            if sync == Sync::Marker {
                assert!(
                    !text.contains("OUT[") && !text.contains("PULSE") && !text.contains("DBBSTB"),
                    "{name}"
                );
            }
        }
    }
}

#[test]
fn logged_axes_are_read_by_row() {
    let plan = plan(1, 3);
    let files = modules(&plan, Sync::Output, Controller::Krc4);
    let (name, text) = files.iter().find(|(name, _)| name == "DBB_C001.dat").unwrap();
    let e = "E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0";
    let logged = format!("XQ[2]={{A1 1.5,A2 -60.25,A3 90.0,A4 0.0,A5 57.0,A6 -1.0E-2,{e}}}\r\nENDDAT");
    let data = parse_data(name, &text.replace("ENDDAT", &logged)).unwrap();
    let second = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit).nth(1).unwrap();
    let logged = logged_axes(&data).unwrap();
    assert_eq!(
        logged.into_iter().collect::<Vec<_>>(),
        [(second.index, [1.5, -60.25, 90.0, 0.0, 57.0, -0.01])]
    );
    for none in
        ["DEFDAT T\nENDDAT\n", "DEFDAT T\nDECL INT DBBROW[1]\nDECL E6AXIS XQ[1]\nXQ[1]={A1 0}\nENDDAT\n"]
    {
        assert_eq!(logged_axes(&parse_data("T.dat", none).unwrap()).unwrap_err().code().as_str(), "E0807");
    }
}

#[test]
fn unsupported_statements_are_refused_with_their_place() {
    for (text, code, line, column) in REFUSED {
        assert_eq!(refused(text), (*code, *line, *column), "{text:?}");
    }
    let wrong = parse_source("T.src", "DEF T ( )\nWIAT SEC 1\nEND\n").unwrap_err();
    assert!(wrong.help_line().is_some_and(|help| help.contains("WAIT")));
}

/// However deep expressions and blocks are nested, the parser and the users of its tree need little stack.
#[test]
fn nesting_depth_is_limited() {
    let many = 100_000;
    for value in ["(", "+", "-", "NOT ", "A[", "{X ", "1+", "1-(", "(1)*"].map(|piece| piece.repeat(many)) {
        assert_eq!(refused(&format!("DEF T ( )\nA={value}1\nEND\n")).0, "E0805");
        let files = Files {
            source: Text { file: "T.src", text: &format!("LIN {value}1\n") },
            data: None,
            config: None,
        };
        assert!(read(files, Given::default()).is_err());
    }
    assert_eq!(refused(&format!("DEF T ( )\n{}", "LOOP\n".repeat(many))).0, "E0805");
    let fields: Vec<String> = (0..60_000).map(|at| format!("F{at} 1")).collect();
    assert_eq!(refused(&format!("DEF T ( )\nA={{{}}}\nEND\n", fields.join(","))).0, "E0803");
    let chain = format!("DEF T ( )\nA={}1\nEND\n", "1+".repeat(150));
    assert_eq!(parsed(&chain).routines[0].body.len(), 1);
}

#[test]
fn other_notations_are_parsed() {
    let source = parsed(
        "&ACCESS RVP\r\ndef t ( )\r\nint n\r\nEXT BAS (BAS_COMMAND :IN,REAL :IN )\r\nGLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE \
         DO IR_STOPM ( )\r\nINTERRUPT ON 3 \r\nBAS (#INITMOV,0 )\r\nptp {E6POS: X 1.0,Y -2.5,S 'B010',T 'H22'} C_PTP C_DIS\r\n\
         circ {X 1.0,Y 1.0,Z 0.0},XP[2],CA 360.0\r\nIF (N<>3) AND NOT $IN[1] THEN\r\nHALT\r\nELSE\r\nwait sec 0\r\n\
         ENDIF\r\nEND\r\n",
    );
    assert_eq!(source.routines[0].name, "T");
    assert_eq!(source.routines[0].body.len(), 6);
    parse_data(
        "T.dat",
        "DEFDAT T PUBLIC\nDECL E6POS XP1={X 1.0,Y 0.0}\nDECL FDAT FP1={TOOL_NO 1,POINT2[] \" \"}\nENDDAT\n",
    )
    .unwrap();
}

#[test]
fn plans_without_a_possible_program_are_refused() {
    let options = Options { sync: Sync::Output, controller: Controller::Krc4 };
    type Spoil = fn(&mut Plan);
    let cases: [(&str, Spoil); 14] = [
        ("E0821", |plan| _ = plan.header.moves.pop()),
        ("E0821", |plan| (plan.rows.clear(), plan.header.moves.clear()).0),
        ("E0821", |plan| plan.header.moves[8].index = 1),
        ("E0821", |plan| plan.header.job.centres.clear()),
        ("E0820", |plan| plan.rows[8].xyz_mm[1] = f64::NAN),
        ("E0820", |plan| plan.rows[8].turn = 64),
        ("E0820", |plan| plan.rows[8].dwell_s = 700.0),
        ("E0820", |plan| (plan.rows[8].motion, plan.header.moves[8].axis_percent) = (MotionKind::Ptp, 0.0)),
        ("E0820", |plan| plan.header.moves.iter_mut().for_each(|time| time.feed_mm_s = 0.0)),
        ("E0820", |plan| plan.header.moves.iter_mut().for_each(|time| time.turn_deg_s = 0.0)),
        ("E0820", |plan| plan.rows[0].motion = MotionKind::Lin),
        ("E0820", |plan| plan.rows[8].centre = dbbd_model::robot::BallId::at(1)),
        ("E0822", |plan| (0..300).for_each(|_| repeat(plan))),
        ("E0823", |plan| plan.header.job.motion.outputs.strobe = 12),
    ];
    for (at, (code, spoil)) in cases.into_iter().enumerate() {
        let mut plan = plan(1, 3);
        spoil(&mut plan);
        assert_eq!(emit(&plan, options).unwrap_err().code().as_str(), code, "case {at}");
    }
}

/// Repeats a dwell at the same pose.
fn repeat(plan: &mut Plan) {
    let at = plan.rows.iter().position(|row| row.kind != PoseKind::Transit).unwrap();
    plan.rows.insert(at, plan.rows[at].clone());
    plan.header.moves.insert(at, plan.header.moves[at]);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// No text makes the parser panic, and the place of a finding is inside the text.
    #[test]
    fn no_text_makes_the_parser_panic(words in proptest::collection::vec(
        prop_oneof!["[ -~]{0,8}", Just("\n".into()), Just("DEF T ( )\n".into()), Just("LIN {X 1.0".into()),
            Just("FOR K=1 TO 2\n".into()), Just("END".into()), Just("\u{e9}'B".into())], 0..20)) {
        let text = words.concat();
        for result in [parse_source("T", &text).map(|_| ()), parse_data("T", &text).map(|_| ())] {
            if let Err(diagnostic) = result {
                prop_assert!(diagnostic.line_number() <= text.matches('\n').count() + 1);
            }
        }
    }
}

/// Between circles the operator is asked to remove the bar, unless the robot is at the start already.
#[test]
fn mounted_bar_needs_no_halt() {
    let halts = |plan: &Plan| {
        let files = modules(plan, Sync::Output, Controller::Krc4);
        let code = files.iter().filter(|(name, _)| name.ends_with(".src"));
        code.map(|(_, text)| text.lines().filter(|line| *line == "HALT").count()).collect::<Vec<_>>()
    };
    let mut plan = plan(2, 8);
    assert_eq!(halts(&plan), [1, 1, 1]);
    let start = plan.rows.iter().position(|row| row.circle == 2).unwrap();
    plan.rows[start].axes_deg = plan.rows[start - 1].axes_deg;
    assert_eq!(halts(&plan), [0, 1, 0]);
}

/// Every dwell is reported twice, with its row of the plan, and the program waits for the answers.
#[test]
fn dwells_are_reported_over_ethernet_krl() {
    use std::io::{Read, Write};
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let server = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let (mut text, mut reported) = (String::new(), Vec::new());
        let mut bytes = [0; 300];
        while let Ok(count @ 1..) = stream.read(&mut bytes) {
            text.push_str(std::str::from_utf8(&bytes[..count]).unwrap());
            while let Some(end) = text.find("</Dbb>") {
                let telegram: String = text.drain(..end + 6).collect();
                let of = |name: &str| {
                    let from = telegram.split_once(&format!("{name}=\"")).unwrap().1;
                    from.split('"').next().unwrap().to_owned()
                };
                reported.push((of("Id").parse::<u32>().unwrap(), of("Ph"), of("A2").parse::<f64>().unwrap()));
                assert!(
                    telegram.starts_with("<Dbb><Pt Run=\"74565\" Id=\"")
                        && telegram.contains("\"></Pt><Ax A1=\"")
                );
                stream.write_all(format!("<Ack Id=\"{}\"/>\n", of("Id")).as_bytes()).unwrap();
            }
        }
        reported
    });
    let plan = plan(2, 3);
    let std::net::SocketAddr::V4(to) = address else { panic!("no IPv4") };
    let files = modules(&plan, Sync::Ekrl { server: to }, Controller::Krc4);
    let (_, channel) = files.iter().find(|(name, _)| name == "DbbEki.xml").unwrap();
    assert!(
        channel.contains(&format!("<PORT>{}</PORT>", to.port())) && channel.contains("Tag=\"Dbb/Ax/@A6\"")
    );
    let mut client = dbbd_job::sim::ekrl::EkrlClient::connect(address).unwrap();
    let controller = || {
        dbbd_job::sim::SimulatedController::new(
            program(&files),
            &crate::test_support::circle_plan::robot(),
            100.0,
        )
        .unwrap()
    };
    let (mut controller, mut unlinked) = (controller(), controller());
    controller.link_ekrl();
    loop {
        let moment = controller.step(0.1).unwrap();
        while let Some(telegram) = controller.telegram() {
            let id = client.exchange(&telegram).unwrap();
            controller.answer(id);
        }
        if moment.halted {
            controller.go_on();
        }
        if moment.done {
            break;
        }
    }
    drop(client);
    let expected: Vec<_> = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit).collect();
    let reported = server.join().unwrap();
    assert_eq!(reported.len(), 2 * expected.len());
    for (reported, row) in reported.chunks(2).zip(expected) {
        assert_eq!(
            (reported[0].0, reported[0].1.as_str(), reported[1].0, reported[1].1.as_str()),
            (row.index, "1", row.index, "2")
        );
        assert!((reported[0].2 - row.axes_deg[1]).abs() < 1e-5);
    }
    let error = loop {
        match unlinked.step(0.1) {
            Ok(_) => unlinked.go_on(),
            Err(error) => break error.code().as_str(),
        }
    };
    assert_eq!(error, "E0818");
    let options = Options { sync: Sync::Ekrl { server: to }, controller: Controller::Krc2 };
    assert_eq!(emit(&plan, options).unwrap_err().code().as_str(), "E0823");
}
