import { mount } from 'svelte';
import App from './App.svelte';
import './app.css';
import { watchForLoss } from './lib/jog';
import { session } from './lib/session.svelte';
import { connect } from './link/connect';
import { prepareStage } from './path/stage';

watchForLoss();
void connect().then((source) => session.start(source));

const target = document.getElementById('app');
if (target === null) throw new Error('index.html has no #app');
mount(App, { target });
prepareStage();
