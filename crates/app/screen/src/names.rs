//! Names and addresses by which browsers reach this computer.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};

/// The address for other computers. For "all addresses" it is the one from which this computer reaches
/// others.
pub(crate) fn public_host(local: SocketAddr) -> IpAddr {
    if !local.ip().is_unspecified() {
        return local.ip();
    }
    let (any, far): (IpAddr, IpAddr) = if local.is_ipv4() {
        (Ipv4Addr::UNSPECIFIED.into(), Ipv4Addr::new(192, 0, 2, 1).into())
    } else {
        (
            Ipv6Addr::UNSPECIFIED.into(),
            Ipv6Addr::new(0x2001, 0xdb8, 0, 0, 0, 0, 0, 1).into(),
        )
    };
    // Connecting a datagram socket chooses a route and sends nothing.
    let routed = UdpSocket::bind((any, 0)).and_then(|socket| {
        socket.connect((far, 9))?;
        socket.local_addr()
    });
    routed.map_or(local.ip(), |address| address.ip())
}

/// Names and addresses of this computer, for its certificate and for `Host`. The machine's name is the first,
/// if it is a valid host name.
pub(crate) fn server_names(machine: &str, hosts: &[String], host: IpAddr) -> Vec<String> {
    let system = rustix::system::uname();
    let own = system.nodename().to_string_lossy().into_owned();
    let is_label = machine.len() < 64
        && !machine.ends_with('-')
        && machine
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || byte == b'-');
    let mut names: Vec<String> = is_label.then(|| machine.to_owned()).into_iter().collect();
    names.extend_from_slice(hosts);
    names.extend([
        format!("{own}.local"),
        own,
        "localhost".to_owned(),
        host.to_string(),
    ]);
    names.retain(|name| !name.is_empty());
    names
}
