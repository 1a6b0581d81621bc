//! Connections: their maximum number, and the time limit of a request.

use std::convert::Infallible;
use std::time::Duration;

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsAcceptor;

use crate::slots::Slots;

/// Maximum number of connections. A page needs up to seven, and each is a file descriptor of the process that
/// moves the machine.
const MAX_CONNECTIONS: usize = 256;
/// Maximum time for establishing a connection and for a request.
const BEGINNING: Duration = Duration::from_secs(10);

/// Serves connections forever.
pub(crate) async fn listen(
    listener: TcpListener,
    router: Router,
    encryption: Option<TlsAcceptor>,
) -> Infallible {
    let slots = Slots::new(MAX_CONNECTIONS);
    loop {
        // Further connections wait in the kernel's queue. The semaphore is never closed.
        let Some(free) = slots.free().await else { continue };
        let (stream, slot) = match listener.accept().await {
            Ok((stream, from)) => match slots.take(free, from.ip()) {
                Some(slot) => (stream, slot),
                // The connection is closed: its client holds its maximum.
                None => continue,
            },
            Err(_) => {
                // No file descriptors are left: other connections end soon.
                tokio::time::sleep(Duration::from_millis(50)).await;
                continue;
            }
        };
        let router = router.clone().layer(Extension(slot.client()));
        let encryption = encryption.clone();
        tokio::spawn(async move {
            serve(stream, router, encryption).await;
            drop(slot);
        });
    }
}

async fn serve(stream: TcpStream, router: Router, encryption: Option<TlsAcceptor>) {
    // A command is small and has to be sent immediately.
    let _delayed = stream.set_nodelay(true);
    match encryption {
        None => answer(stream, router).await,
        Some(acceptor) => {
            if let Ok(Ok(encrypted)) = tokio::time::timeout(BEGINNING, acceptor.accept(stream)).await {
                answer(encrypted, router).await;
            }
        }
    }
}

async fn answer(stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static, router: Router) {
    let service = TowerToHyperService::new(router);
    // The end of a connection concerns only its client.
    let _ended = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(BEGINNING)
        .max_buf_size(64 << 10)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades()
        .await;
}
