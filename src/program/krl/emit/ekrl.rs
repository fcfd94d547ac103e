//! The EthernetKRL side of a program: each dwell is reported to dbbd over TCP, and waits for its answer.
//!
//! The controller is the client, dbbd the server. `<Dbb>` carries the run, the plan's row, the phase
//! (1: the robot is at rest, 2: the dwell is over) and the measured axes; `<Ack Id=".."/>` answers it.

use std::net::SocketAddrV4;

use super::{Lines, Writer};

/// Name of the channel, of its file on the controller, and of its flags: 1 while it is connected, 2 when
/// an answer has come.
const CHANNEL: &str = "DbbEki";

/// The channel's file, for `C:\KRC\ROBOTER\Config\User\Common\EthernetKRL`.
pub(super) fn channel(server: SocketAddrV4) -> (String, String) {
    let mut xml = Lines::default();
    xml.all(&["<ETHERNETKRL>", "  <CONFIGURATION>", "    <EXTERNAL>"]);
    xml.add(format!("      <IP>{}</IP>", server.ip()));
    xml.add(format!("      <PORT>{}</PORT>", server.port()));
    xml.all(&[
        "      <TYPE>Server</TYPE>",
        "    </EXTERNAL>",
        "    <INTERNAL>",
        "      <ENVIRONMENT>Program</ENVIRONMENT>",
        r#"      <BUFFERING Mode="FIFO" Limit="16"/>"#,
        r#"      <TIMEOUT Connect="60000"/>"#,
        r#"      <ALIVE Set_Flag="1" Ping="200"/>"#,
        "      <PROTOCOL>TCP</PROTOCOL>",
        r#"      <MESSAGES Logging="warning" Display="disabled"/>"#,
        "    </INTERNAL>",
        "  </CONFIGURATION>",
        "  <RECEIVE>",
        "    <XML>",
        r#"      <ELEMENT Tag="Ack/@Id" Type="INT"/>"#,
        r#"      <ELEMENT Tag="Ack" Set_Flag="2"/>"#,
        "    </XML>",
        "  </RECEIVE>",
        "  <SEND>",
        "    <XML>",
    ]);
    for tag in ["Pt/@Run", "Pt/@Id", "Pt/@Ph", "Ax/@A1", "Ax/@A2", "Ax/@A3", "Ax/@A4", "Ax/@A5", "Ax/@A6"] {
        xml.add(format!(r#"      <ELEMENT Tag="Dbb/{tag}"/>"#));
    }
    xml.all(&["    </XML>", "  </SEND>", "</ETHERNETKRL>"]);
    (format!("{CHANNEL}.xml"), xml.0)
}

impl Writer<'_> {
    /// A number of the plan, from its hash: a server recognises the run of another plan.
    fn run_number(&self) -> u32 {
        let digits = self.plan.header.hash.get(..4).unwrap_or("0");
        u32::from_str_radix(digits, 16).unwrap_or(0)
    }

    pub(super) fn ekrl_data(&self, data: &mut Lines) {
        data.add("; the run's number, the row that was answered, the last answer of EthernetKRL");
        data.add(format!("DECL INT RUNID={}", self.run_number()));
        data.all(&["DECL INT NACK=0", "DECL EKI_STATUS RET"]);
    }

    pub(super) fn ekrl_open(source: &mut Lines) {
        source.add("$FLAG[2]=FALSE");
        source.add(format!("RET=EKI_Init (\"{CHANNEL}\")"));
        source.add(format!("RET=EKI_Open (\"{CHANNEL}\")"));
        source.add("WAIT FOR $FLAG[1]");
    }

    pub(super) fn ekrl_close(source: &mut Lines) {
        source.add(format!("RET=EKI_Close (\"{CHANNEL}\")"));
        source.add(format!("RET=EKI_Clear (\"{CHANNEL}\")"));
    }

    pub(super) fn ekrl_subroutine(source: &mut Lines) {
        source.all(&[
            "",
            "DEF DBB_ESEND (N :IN,PH :IN )",
            "INT N,PH",
            "; tell row N, phase PH, and wait for the answer",
            "$FLAG[2]=FALSE",
        ]);
        for (tag, value) in [("Run", "RUNID"), ("Id", "N"), ("Ph", "PH")] {
            source.add(format!("RET=EKI_SetInt (\"{CHANNEL}\",\"Dbb/Pt/@{tag}\",{value})"));
        }
        for axis in 1..=6 {
            let value = format!("$AXIS_ACT_MEAS.A{axis}");
            source.add(format!("RET=EKI_SetReal (\"{CHANNEL}\",\"Dbb/Ax/@A{axis}\",{value})"));
        }
        source.add(format!("RET=EKI_Send (\"{CHANNEL}\",\"Dbb\")"));
        source.add("WAIT FOR $FLAG[2]");
        source.add(format!("RET=EKI_GetInt (\"{CHANNEL}\",\"Ack/@Id\",NACK)"));
        source.all(&["IF NACK<>N THEN", "   HALT", "ENDIF", "END"]);
    }
}
