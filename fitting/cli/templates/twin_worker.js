// In the page's worker: simulates for the last values that it was sent, and gives up on those before.
if (typeof self !== 'undefined' && typeof window === 'undefined') {
    let twin = null, wanted = 0;
    self.onmessage = async ({ data }) => {
        if (data.module) { twin = makeTwin(data.module, data.facts); }
        const mine = data.number;
        wanted = mine;
        try {
            for (const motion of twin.simulate(data.values)) {
                self.postMessage({ number: mine, motion });
                await new Promise((done) => { setTimeout(done); }); // newer values arrive meanwhile
                if (wanted !== mine) { return; }
            }
        } catch (error) {
            self.postMessage({ number: mine, error: error.message });
        }
    };
}
