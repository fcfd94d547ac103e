//! Lists the serial ports.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serialport::SerialPortType;

use crate::port::PortAddress;
use crate::port::PortFinding::{self, NoPortList};

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PortInfo {
    pub port: String,
    /// Permanent name of the device, if it has one.
    pub by_id: Option<String>,
    pub description: String,
    /// Vendor and product number.
    usb_id: Option<(u16, u16)>,
    pub vendor: Option<String>,
    pub product: Option<String>,
    serial_number: Option<String>,
    /// Latency timer of the adapter, ms, if known: more than 1 makes time stamps inaccurate.
    pub latency_ms: Option<u32>,
}

impl PortInfo {
    /// A port that is named by an address, such as that of a serial server.
    pub fn named(port: &PortAddress) -> Self {
        Self {
            port: port.to_string(),
            by_id: None,
            description: String::new(),
            usb_id: None,
            vendor: None,
            product: None,
            serial_number: None,
            latency_ms: None,
        }
    }

    /// Whether this is the port with a name or a permanent name.
    pub fn is(&self, name: &str) -> bool {
        self.port == name || self.by_id.as_deref() == Some(name)
    }
}

/// The ports, sorted by name; on Linux only those with a device.
pub fn list_ports() -> Result<Vec<PortInfo>, PortFinding> {
    let links = links();
    let ports = serialport::available_ports().map_err(|error| NoPortList { why: error.to_string() })?;
    let mut found: Vec<PortInfo> = ports
        .into_iter()
        .map(|info| {
            let device = Path::new(&info.port_name);
            let usb = if let SerialPortType::UsbPort(usb) = &info.port_type { Some(usb) } else { None };
            PortInfo {
                usb_id: usb.map(|usb| (usb.vid, usb.pid)),
                vendor: usb.and_then(|usb| usb.manufacturer.clone()),
                product: usb.and_then(|usb| usb.product.clone()),
                serial_number: usb.and_then(|usb| usb.serial_number.clone()),
                by_id: links.get(device).cloned(),
                description: description(&info.port_type),
                latency_ms: super::adapter::latency_ms(device),
                port: info.port_name,
            }
        })
        .collect();
    found.sort_by(|a, b| a.port.cmp(&b.port));
    Ok(found)
}

/// Devices and their names under `/dev/serial/by-id`.
fn links() -> BTreeMap<PathBuf, String> {
    let entries = fs::read_dir("/dev/serial/by-id").into_iter().flatten().flatten();
    entries
        .filter_map(|entry| {
            let device = fs::canonicalize(entry.path()).ok()?;
            Some((device, format!("by-id/{}", entry.file_name().to_string_lossy())))
        })
        .collect()
}

fn description(kind: &SerialPortType) -> String {
    match kind {
        SerialPortType::UsbPort(usb) => {
            let words = [usb.manufacturer.as_deref(), usb.product.as_deref()];
            let mut words: Vec<String> = words.into_iter().flatten().map(str::to_owned).collect();
            words.extend(usb.serial_number.as_ref().map(|number| format!("serial number {number}")));
            format!("USB {:04x}:{:04x} {}", usb.vid, usb.pid, words.join(" ")).trim_end().to_owned()
        }
        SerialPortType::PciPort => "PCI".into(),
        SerialPortType::BluetoothPort => "Bluetooth".into(),
        SerialPortType::Unknown => "unknown".into(),
    }
}
