// SPDX-License-Identifier: GPL-3.0-or-later
/** The worker's end of calls (calls.js). */
import { sentence } from "./errors.js";
import { Service } from "./service.js";

const service = new Service();

self.onmessage = async ({ data: { number, name, given } }) => {
  try {
    const answer = await service[name](given, (progress) => self.postMessage({ number, progress }));
    const buffers = ["texels", "list"].map((key) => answer && answer[key] && answer[key].buffer).filter(Boolean);
    self.postMessage({ number, answer }, buffers);
  } catch (error) {
    self.postMessage({ number, failed: sentence(error) });
  }
};
