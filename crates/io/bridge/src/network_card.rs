//! Settings of a network card, its driver and the CPUs that delay packets, for `evolvent doctor --network`.

use std::fs::read_to_string;
use std::io;
use std::net::{Ipv4Addr, UdpSocket};
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};

/// Suitability for a real-time network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum CardVerdict {
    /// Nothing to change.
    Good,
    /// May delay packets occasionally.
    Fair,
    /// Delays or loses packets.
    Bad,
}

/// One examined item.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CardFinding {
    /// Its name.
    pub name: &'static str,
    /// Its value.
    pub value: String,
    /// Its suitability.
    pub verdict: CardVerdict,
    /// What to change, if anything.
    pub advice: Option<String>,
}

fn finding(
    name: &'static str,
    value: impl Into<String>,
    wrong: Option<(CardVerdict, String)>,
) -> CardFinding {
    let (verdict, advice) = match wrong {
        Some((verdict, advice)) => (verdict, Some(advice)),
        None => (CardVerdict::Good, None),
    };
    CardFinding {
        name,
        value: value.into(),
        verdict,
        advice,
    }
}

/// Examines a network interface, the settings of its driver, and the CPU frequency governors. Items that the
/// driver or the system does not report are omitted.
///
/// # Errors
/// There is no such interface.
pub fn examine_card(interface: &str) -> io::Result<Vec<CardFinding>> {
    let is_name = !interface.is_empty() && interface.len() < 16 && !interface.contains(['/', '\0']);
    let index = index_of(interface).filter(|_| is_name && !interface.starts_with('.'));
    let Some(index) = index else {
        return Err(io::Error::from(io::ErrorKind::NotFound));
    };
    let driver = Driver::open(interface)?;
    // If /sys belongs to another network namespace, its files describe another interface, or are missing.
    let folder = Path::new("/sys/class/net").join(interface);
    let folder = (number(folder.join("ifindex")) == Some(u64::from(index))).then_some(folder);
    let mut findings = Vec::new();
    link(&driver, interface, &mut findings);
    if let Some(folder) = &folder {
        speed_and_errors(folder, &mut findings);
        kind(folder, interface, &mut findings);
    }
    driver.examine(interface, &mut findings);
    governors(&mut findings);
    Ok(findings)
}

/// A file of one line.
fn line(path: PathBuf) -> Option<String> {
    read_to_string(path).ok().map(|text| text.trim().to_owned())
}

fn number(path: PathBuf) -> Option<u64> {
    line(path)?.parse().ok()
}

/// The kernel's number of an interface of this network namespace.
fn index_of(interface: &str) -> Option<u32> {
    let name = std::ffi::CString::new(interface).ok()?;
    // SAFETY: the name is a string that ends with a zero byte.
    let index = unsafe { libc::if_nametoindex(name.as_ptr()) };
    (index != 0).then_some(index)
}

/// Carrier.
fn link(driver: &Driver, interface: &str, findings: &mut Vec<CardFinding>) {
    let is_up = driver.ask::<2>(GET_LINK).is_some_and(|[_, up]| up != 0);
    let wrong = (!is_up).then(|| {
        let advice = format!("connect the cable, switch on the other end, and `ip link set {interface} up`");
        (CardVerdict::Bad, advice)
    });
    findings.push(finding("link", if is_up { "up" } else { "down" }, wrong));
}

fn speed_and_errors(folder: &Path, findings: &mut Vec<CardFinding>) {
    if let Some(speed) = number(folder.join("speed")).filter(|speed| *speed < 1_000_000) {
        let duplex = line(folder.join("duplex")).unwrap_or_default();
        let is_slow = speed < 100 || duplex == "half";
        let wrong = is_slow.then(|| {
            let advice = "at least 100 Mb/s full duplex is needed: replace the cable, and enable \
                          autonegotiation at both ends";
            (CardVerdict::Bad, advice.to_owned())
        });
        findings.push(finding("speed", format!("{speed} Mb/s, {duplex} duplex"), wrong));
    }
    let statistics = folder.join("statistics");
    let counted: Vec<(&str, u64)> = [
        "rx_errors",
        "rx_crc_errors",
        "rx_dropped",
        "tx_errors",
        "tx_dropped",
    ]
    .into_iter()
    .filter_map(|name| Some((name, number(statistics.join(name))?)))
    .filter(|(_, count)| *count > 0)
    .collect();
    let value = if counted.is_empty() {
        "none".to_owned()
    } else {
        let texts: Vec<String> = counted
            .iter()
            .map(|(name, count)| format!("{name} {count}"))
            .collect();
        texts.join(", ")
    };
    let wrong = (!counted.is_empty()).then(|| {
        let advice = "counted since the interface was created: if they increase while the machine runs, \
                      replace cable or card";
        (CardVerdict::Fair, advice.to_owned())
    });
    findings.push(finding("errors", value, wrong));
}

/// Driver; wireless or USB cards; members of a bridge or bond.
fn kind(folder: &Path, interface: &str, findings: &mut Vec<CardFinding>) {
    let device = folder.join("device").canonicalize().ok();
    let driver = folder.join("device/driver").canonicalize().ok();
    let name = driver.as_deref().and_then(Path::file_name);
    let name = name.map_or_else(
        || "virtual".to_owned(),
        |name| name.to_string_lossy().into_owned(),
    );
    let wrong = if folder.join("wireless").exists() {
        Some("wireless: packets are late and lost; use a cable")
    } else if device.is_some_and(|path| path.to_string_lossy().contains("/usb")) {
        Some("a USB adapter: packets wait for the next USB frame, up to 1 ms; use a PCI Express card")
    } else {
        None
    };
    let wrong = wrong.map(|advice| (CardVerdict::Bad, advice.to_owned()));
    findings.push(finding("driver", name, wrong));
    if folder.join("master").exists() {
        let advice = format!("use a separate card for the machine: `ip link set {interface} nomaster`");
        findings.push(finding(
            "bridge or bond",
            "a member of one",
            Some((CardVerdict::Bad, advice)),
        ));
    }
}

/// Settings of the driver, read by the ioctl of `ethtool`.
struct Driver {
    socket: UdpSocket,
    name: [u8; 16],
}

/// Requests of `linux/ethtool.h`.
const GET_LINK: u32 = 0x0A;
const GET_COALESCE: u32 = 0x0E;
const GET_TSO: u32 = 0x1E;
const GET_GSO: u32 = 0x23;
const GET_FLAGS: u32 = 0x25;
const GET_GRO: u32 = 0x2B;
const GET_EEE: u32 = 0x44;
/// Flag of large receive offload.
const LRO: u32 = 1 << 15;
const SIOCETHTOOL: libc::c_ulong = 0x8946;

/// `struct ifreq` with a pointer in its union.
#[repr(C)]
struct Request {
    name: [u8; 16],
    data: *mut u32,
    rest: [u8; 16],
}

impl Driver {
    fn open(interface: &str) -> io::Result<Self> {
        let mut name = [0; 16];
        name[..interface.len()].copy_from_slice(interface.as_bytes());
        // The ioctl needs any socket.
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        Ok(Self { socket, name })
    }

    /// Words of the reply, with the request first; `None` if the driver does not support it.
    fn ask<const WORDS: usize>(&self, request: u32) -> Option<[u32; WORDS]> {
        let mut words = [0; WORDS];
        words[0] = request;
        let mut call = Request {
            name: self.name,
            data: words.as_mut_ptr(),
            rest: [0; 16],
        };
        // SAFETY: the kernel writes as many words as the structure of the request has, which is `WORDS` at
        // each call; both outlive the call.
        let result = unsafe { libc::ioctl(self.socket.as_raw_fd(), SIOCETHTOOL as _, &raw mut call) };
        (result == 0).then_some(words)
    }

    fn examine(&self, interface: &str, findings: &mut Vec<CardFinding>) {
        // Words of `struct ethtool_coalesce`: 1 rx us, 2 rx frames, 5 tx us, 10 and 11 adaptive.
        if let Some(words) = self.ask::<23>(GET_COALESCE) {
            let (rx_us, adaptive) = (words[1], words[10] != 0 || words[11] != 0);
            let value = format!("rx {rx_us} us, {} frames, adaptive {adaptive}", words[2]);
            let wrong = (rx_us > 0 || adaptive).then(|| {
                let advice = format!(
                    "received packets are delayed: `ethtool -C {interface} adaptive-rx off rx-usecs 0`"
                );
                (
                    if rx_us > 20 || adaptive {
                        CardVerdict::Bad
                    } else {
                        CardVerdict::Fair
                    },
                    advice,
                )
            });
            findings.push(finding("coalescing", value, wrong));
        }
        let value = |request| self.ask::<2>(request).map(|[_, value]| value);
        let on: Vec<&str> = [
            ("gro", value(GET_GRO).is_some_and(|value| value != 0)),
            ("lro", value(GET_FLAGS).is_some_and(|flags| flags & LRO != 0)),
            ("gso", value(GET_GSO).is_some_and(|value| value != 0)),
            ("tso", value(GET_TSO).is_some_and(|value| value != 0)),
        ]
        .into_iter()
        .filter_map(|(name, on)| on.then_some(name))
        .collect();
        // Send offloads do not affect single small packets.
        let receiving: Vec<&&str> = on.iter().filter(|name| matches!(**name, "gro" | "lro")).collect();
        let wrong = (!receiving.is_empty()).then(|| {
            let off: Vec<String> = receiving.iter().map(|name| format!("{name} off")).collect();
            let advice = format!(
                "received packets are held back to be merged: `ethtool -K {interface} {}`",
                off.join(" ")
            );
            (CardVerdict::Fair, advice)
        });
        let value = if on.is_empty() {
            "none".to_owned()
        } else {
            on.join(", ")
        };
        findings.push(finding("offloads", value, wrong));
        // Words of `struct ethtool_eee`: 4 active, 5 enabled.
        if let Some(words) = self.ask::<10>(GET_EEE) {
            let is_on = words[4] != 0 || words[5] != 0;
            let wrong = is_on.then(|| {
                let advice =
                    format!("the link sleeps between packets: `ethtool --set-eee {interface} eee off`");
                (CardVerdict::Bad, advice)
            });
            findings.push(finding(
                "energy efficient Ethernet",
                if is_on { "on" } else { "off" },
                wrong,
            ));
        }
    }
}

/// CPU frequency governors.
fn governors(findings: &mut Vec<CardFinding>) {
    let Ok(entries) = std::fs::read_dir("/sys/devices/system/cpu/cpufreq") else {
        return;
    };
    let mut found: Vec<String> = entries
        .filter_map(|entry| line(entry.ok()?.path().join("scaling_governor")))
        .collect();
    found.sort_unstable();
    found.dedup();
    if found.is_empty() {
        return;
    }
    let wrong = found.iter().any(|governor| governor != "performance").then(|| {
        let advice = "a CPU at a low frequency replies late: `cpupower frequency-set -g performance`";
        (CardVerdict::Fair, advice.to_owned())
    });
    findings.push(finding("governor", found.join(", "), wrong));
}
